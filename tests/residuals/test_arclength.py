from dataclasses import replace

import numpy as np
import pytest
from conftest import simulation, st16_config, st16_matcher

from stcal.matching import match
from stcal.residuals import ARCLENGTH, choose_arcs, select_stars
from stcal.residuals.arclength import separations
from stcal.residuals.arclength_kernels import arc_tables
from stcal.residuals.ordering_kernels import flatness2
from stcal.residuals.selection import StarSelection

SIGMA = np.array([8e-6, 30.0, 30.0, 1e8, 1e3, 0.01, 0.01, 2e-4])


@pytest.fixture(scope="module")
def data():
    return simulation(4, 21, 60)


@pytest.fixture(scope="module")
def selection(data):
    frames = data.calibration.frames
    matched = match(frames, data.true.camera, np.eye(3), st16_matcher())
    return select_stars(matched, st16_config().noise, 4)


@pytest.fixture(scope="module")
def bound(data, selection):
    return ARCLENGTH.bind(selection, data.true.camera)


@pytest.fixture(scope="module")
def arcs(selection):
    return choose_arcs(selection)


def tables(bound, parameters):
    """What ``bind`` has made of a selection of one block."""
    (block,) = bound.blocks
    return arc_tables(block.ints, block.floats, parameters)


def dense_covariance(arcs, camera):
    """R by (16)-(18) as printed: dihedral angles from the spherical law of cosines."""
    s, sel = arcs.selection.s_i, arcs.selection
    sd = sel.sd_px * camera.noise_scale(sel.row_px, sel.col_px)
    angle = lambda a, b: np.arccos(np.clip(s[a] @ s[b], -1, 1))  # noqa: E731
    n = len(arcs.pair_i)
    R = np.zeros((n, n))
    for k in range(n):
        R[k, k] = sd[arcs.pair_i[k]] ** 2 + sd[arcs.pair_j[k]] ** 2
        for m in range(max(0, k - 8), k):
            if arcs.starts[m] != arcs.starts[k]:
                continue
            shared = {arcs.pair_i[k], arcs.pair_j[k]} & {arcs.pair_i[m], arcs.pair_j[m]}
            if len(shared) == 1:
                j = shared.pop()
                i = ({arcs.pair_i[k], arcs.pair_j[k]} - {j}).pop()
                l = ({arcs.pair_i[m], arcs.pair_j[m]} - {j}).pop()  # noqa: E741
                a, b, c = angle(i, j), angle(j, l), angle(i, l)
                cosine = (np.cos(c) - np.cos(a) * np.cos(b)) / (np.sin(a) * np.sin(b))
                R[k, m] = R[m, k] = sd[j] ** 2 * cosine
    return R


def test_arcs_follow_the_2n_minus_3_rule(arcs, bound):
    counts = np.diff(bound.selection.offsets)
    assert len(arcs.pair_i) == (2 * counts - 3).sum()
    assert bound.dependent <= 0.001 * len(arcs.pair_i)
    exposure = bound.selection.exposure
    assert (exposure[arcs.pair_i] == exposure[arcs.pair_j]).all()
    pairs = np.sort(np.stack([arcs.pair_i, arcs.pair_j], axis=1), axis=1)
    assert len(np.unique(pairs, axis=0)) == len(pairs)


def test_no_three_stars_in_sequence_are_collinear(arcs):
    """Arcs (i, i+1), (i, i+2) of one exposure name its triples in sequence."""
    s = arcs.selection.s_i
    flat = []
    for k in range(len(arcs.pair_i) - 1):
        same = arcs.starts[k] == arcs.starts[k + 1] and arcs.pair_i[k] == arcs.pair_i[k + 1]
        if same:
            i, j, l = arcs.pair_i[k], arcs.pair_j[k], arcs.pair_j[k + 1]  # noqa: E741
            flat.append(np.sqrt(flatness2(*s[i], *s[j], *s[l])))
    assert np.median(flat) > 0.3
    assert np.mean(np.array(flat) < 0.02) < 0.01


def test_whitening_is_the_inverse_cholesky_factor_of_r(arcs, bound, data):
    camera = data.initial.camera
    R = dense_covariance(arcs, data.true.camera)
    lower, _, slope, reference = tables(bound, len(camera.parameters))
    keep = np.isfinite(lower[:, -1])
    root = np.linalg.cholesky(R[np.ix_(keep, keep)])
    s, by_parameter, _ = camera.jacobian(bound.selection.row_px, bound.selection.col_px)
    i, j = arcs.pair_i, arcs.pair_j
    sine = np.sin(separations(s[i], s[j]))
    H = (
        -(
            np.einsum("kap,ka->kp", by_parameter[j], s[i])
            + np.einsum("kap,ka->kp", by_parameter[i], s[j])
        )
        / sine[:, None]
    )
    e = arcs.departures(camera)[:, None]
    scale = np.exp(slope @ (camera.parameters - reference))[:, None]
    rows = (np.column_stack([H - e * slope, e]) / scale)[keep]
    expected = np.linalg.solve(root, rows)
    found = bound.linearise(camera)[keep]
    scale = np.abs(expected).max(axis=0)
    np.testing.assert_allclose(found / scale, expected / scale, atol=2e-6)


def test_jacobian_agrees_with_finite_differences(bound, data):
    camera = data.true.camera
    rows = bound.linearise(camera)
    for k, sigma in enumerate(SIGMA):
        step = np.zeros(8)
        step[k] = 1e-2 * sigma
        plus, minus = (
            bound.linearise(camera.with_parameters(camera.parameters + sign * step))[:, -1]
            for sign in (1, -1)
        )
        numeric = (plus - minus) / 2e-2
        scale = np.abs(numeric).max()
        np.testing.assert_allclose(rows[:, k] * sigma / scale, numeric / scale, atol=3e-5)


def test_whitened_residuals_are_white_with_the_true_camera(data):
    """Simulated centroids have isotropic noise: the rows must be independent of unit variance."""
    part = data.calibration
    matched = match(part.frames, data.true.camera, np.eye(3), st16_matcher())
    selection = select_stars(matched, st16_config().noise, 4)
    clean = ~part.truth.outlier[selection.star]
    selection = selection.keep(clean, 4)
    sd = part.truth.sd_px[selection.star]
    selection = StarSelection(
        selection.star, selection.exposure, selection.row_px, selection.col_px, selection.s_i, sd,
        selection.n_exposures,
    )  # fmt: skip
    r = ARCLENGTH.bind(selection, data.true.camera).linearise(data.true.camera)[:, -1]
    assert len(r) > 800
    assert r.std() == pytest.approx(1.0, abs=4.0 / np.sqrt(2 * len(r)))
    for lag in (1, 2, 3, 4):
        assert abs(np.mean(r[lag:] * r[:-lag])) < 4.0 / np.sqrt(len(r))


def test_information_equals_the_joint_problem_with_attitudes_projected_out(bound, data):
    """An independent formulation: directions, with three attitude angles per exposure removed."""
    camera, sel = data.true.camera, bound.selection
    rows = bound.linearise(camera)[:, :8] * SIGMA
    arcs = rows.T @ rows
    s, by_parameter, _ = camera.jacobian(sel.row_px, sel.col_px)
    sd = sel.sd_px * camera.noise_scale(sel.row_px, sel.col_px)
    total = np.zeros((8, 8))
    for first, last in zip(sel.offsets[:-1], sel.offsets[1:], strict=True):
        J = (by_parameter[first:last] * SIGMA / sd[first:last, None, None]).reshape(-1, 8)
        cross = np.zeros((last - first, 3, 3))
        x, y, z = s[first:last].T
        cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = z, -y, x
        cross -= cross.swapaxes(1, 2)
        A = (cross / sd[first:last, None, None]).reshape(-1, 3)
        total += J.T @ J - J.T @ A @ np.linalg.solve(A.T @ A, A.T @ J)
    ratio = np.linalg.eigvals(np.linalg.solve(total, arcs)).real
    np.testing.assert_allclose(ratio, 1.0, atol=0.01)


def test_separations_are_exact_for_short_arcs():
    angle = np.array([1e-9, 1e-6, 0.1, 1.5, 3.0])
    a = np.tile([1.0, 0.0, 0.0], (5, 1))
    b = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(5)])
    np.testing.assert_allclose(separations(a, b), angle, rtol=1e-10)


def test_collinear_stars_lose_only_the_dependent_arc():
    angle = np.radians([0.0, 3.0, 7.0])
    s = np.column_stack([np.sin(angle), np.zeros(3), np.cos(angle)])
    camera = simulation(4, 21, 60).initial.camera
    m, n = camera.project(s)
    line = StarSelection(np.arange(3), np.zeros(3, int), m, n, s, np.full(3, 0.3), 1)
    bound = ARCLENGTH.bind(line, camera)
    assert bound.dependent == 1
    assert bound.rows == 2
    assert np.isfinite(bound.linearise(camera)).all()


def test_the_noise_in_rad_follows_the_camera(arcs, bound, data):
    """The scale at another camera is what binding there would give."""
    true, initial = data.true.camera.parameters, data.initial.camera.parameters
    other = data.true.camera.with_parameters(true + 0.2 * (initial - true))
    again = ARCLENGTH.bind(bound.selection, other)
    i, j = arcs.pair_i, arcs.pair_j
    sel = bound.selection

    def sd(camera):
        star = sel.sd_px * camera.noise_scale(sel.row_px, sel.col_px)
        return np.hypot(star[i], star[j])

    _, _, slope, reference = tables(bound, len(true))
    scale = np.exp(slope @ (other.parameters - reference))
    np.testing.assert_allclose(scale, sd(other) / sd(data.true.camera), rtol=1e-3)
    assert np.ptp(scale) > 2e-3
    np.testing.assert_allclose(tables(again, len(true))[3], other.parameters)


def test_noise_does_not_bias_the_gradient():
    """At the true camera the gradient is zero in the mean; with R held fixed it is not."""
    data = simulation(2, 61, 300)
    part, camera, rng = data.calibration, data.true.camera, np.random.default_rng(3)
    matched = match(part.frames, camera, np.eye(3), st16_matcher())
    stars = select_stars(matched, st16_config().noise, 4)
    c_di = matched.c_di[part.frames.exposure_of_star[stars.star]]
    m, n = camera.project(np.einsum("kij,kj->ki", c_di, stars.s_i))
    scores = {"following": [], "fixed": []}
    for _ in range(40):
        row, col = m + rng.normal(0, 4.0, m.shape), n + rng.normal(0, 4.0, n.shape)
        bound = ARCLENGTH.bind(
            replace(stars, row_px=row, col_px=col, sd_px=np.full(len(m), 4.0)), camera
        )
        blocks = tuple(replace(b, floats=b.floats.copy()) for b in bound.blocks)
        for block in blocks:
            arc_tables(block.ints, block.floats, 8)[2][:] = 0.0
        fixed = replace(bound, blocks=blocks)
        for name, one in (("following", bound), ("fixed", fixed)):
            rows = one.linearise(camera)
            H, r = rows[:, :8] * SIGMA, rows[:, 8]
            scores[name].append(H.T @ r / np.sqrt((H * H).sum(axis=0)))
    mean = {name: np.abs(np.mean(z, axis=0)).max() for name, z in scores.items()}
    assert mean["following"] < 3.5 / np.sqrt(40)
    assert mean["fixed"] > 0.6
