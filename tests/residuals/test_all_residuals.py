"""Every residual with every camera: derivatives, whiteness, information, and oracles of each."""

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stcal.cameras import CAMERAS, Camera
from stcal.errors import UsageError
from stcal.residuals import RESIDUALS, Residual, StarSelection

# Detector, pixel, nominal parameters and a step of each that moves stars by a few hundredths of a
# pixel: an ST-16, the sensors of Wu 2019 and of Zhang 2024.
SENSORS = {
    "wang": (
        (1944, 2592, 2.2e-6), (0.016, 972.0, 1296.0, 4e8, 3e3, 0.004, -0.006, 1.0005),
        (8e-8, 0.3, 0.3, 1e6, 10.0, 1e-4, 1e-4, 2e-6),
    ),
    "pinhole-radial": (
        (1080, 1920, 2.9e-6), (1.0, 0.016, 970.0, 550.0, -0.5, 0.5),
        (2e-6, 8e-8, 0.3, 0.3, 2e-3, 2e-2),
    ),
    "pixel-radial": (
        (1024, 1024, 18e-6), (511.5, 505.0, 0.074, 2e-8, -1e-14),
        (0.3, 0.3, 4e-7, 1e-10, 1e-16),
    ),
}  # fmt: skip
SINGULAR = [Residual("singular-values", g, v) for g in (1, 2, 3, 4) for v in ((2, 3), (1,), (3,))]
ALL = [Residual(name) for name in RESIDUALS] + SINGULAR


def named(residual):
    return f"{residual.name}-{residual.groups}-{residual.values}"


def camera_of(model):
    (rows, cols, pixel), nominal, _ = SENSORS[model]
    return Camera(CAMERAS[model], rows, cols, pixel, np.array(nominal))


def scene(camera, exposures, sd_px, seed=1, counts=(5, 24)):
    """Exposures with random stars, noisy centroids and a random attitude each."""
    rng = np.random.default_rng(seed)
    number = np.repeat(np.arange(exposures), rng.integers(*counts, exposures))
    m, n = (rng.uniform(10, size - 10, len(number)) for size in (camera.rows, camera.cols))
    c_id = Rotation.random(exposures, rng=rng).as_matrix()
    s_i = np.einsum("kij,kj->ki", c_id[number], camera.directions(m, n))
    noise = rng.normal(0.0, sd_px, (2, len(number)))
    sd = np.full(len(number), sd_px)
    everything = np.arange(len(number))
    return StarSelection(everything, number, m + noise[0], n + noise[1], s_i, sd, exposures)


def free_rows(bound, camera):
    """Whitened rows without the dependent ones, which are zero in whole."""
    rows = bound.linearise(camera)
    return rows[rows[:, :-1].any(axis=1)]


@pytest.mark.parametrize("model", SENSORS)
@pytest.mark.parametrize("residual", ALL, ids=named)
def test_derivatives_agree_with_finite_differences(residual, model):
    camera, steps = camera_of(model), SENSORS[model][2]
    bound = residual.bind(scene(camera, 12, 0.1), camera)
    rows = bound.linearise(camera)
    for k, step in enumerate(steps):
        plus, minus = (
            bound.linearise(camera.with_parameters(camera.parameters + sign * h))[:, -1]
            for sign in (1.0, -1.0)
            for h in [np.eye(len(steps))[k] * step]
        )
        numeric, analytic = (plus - minus) / 2.0, rows[:, k] * step
        scale = np.abs(numeric).max()
        np.testing.assert_allclose(analytic / scale, numeric / scale, atol=2e-4)


@pytest.mark.parametrize("model", SENSORS)
@pytest.mark.parametrize("residual", [r for r in ALL if r.name != "cosine"], ids=named)
def test_residuals_of_the_true_camera_are_white(residual, model):
    """0.5 px is the noise of Wu's images, where second-order terms show when rows are too weak."""
    camera = camera_of(model)
    stars = scene(camera, 150, 0.5, seed=4)
    bound = residual.bind(stars, camera)
    r = free_rows(bound, camera)[:, -1]
    assert len(r) == bound.rows
    assert len(r) > 250
    assert np.mean(r**2) == pytest.approx(1.0, abs=4.5 * np.sqrt(2.0 / len(r)))
    assert abs(np.mean(r)) < 4.5 / np.sqrt(len(r))
    assert abs(np.mean(r[1:] * r[:-1])) < 4.5 / np.sqrt(len(r))
    assert np.abs(r).max() < 5.5


@pytest.mark.parametrize("model", SENSORS)
def test_cosines_are_of_unit_variance_on_the_average_only(model):
    """All pairs of an exposure get one variance: wide pairs scatter more than narrow ones."""
    camera = camera_of(model)
    stars = scene(camera, 300, 0.3, seed=5)
    r = Residual("cosine").bind(stars, camera).linearise(camera)[:, -1]
    assert np.mean(r**2) == pytest.approx(1.0, abs=0.1)
    # Neighbouring pairs share stars, which the published covariance leaves out.
    assert np.mean(r[1:] * r[:-1]) > 5.0 / np.sqrt(len(r))


def normal_matrix(residual, stars, camera, steps):
    rows = residual.bind(stars, camera).linearise(camera)
    H = rows[:, :-1] * np.array(steps)
    return H.T @ H


@pytest.mark.parametrize("model", SENSORS)
@pytest.mark.parametrize("residual", ALL, ids=named)
def test_noise_in_rad_follows_the_camera(residual, model):
    """Bound at a focal length 2 % longer, residuals of the true camera are scaled as if at it."""
    camera = camera_of(model)
    stars = scene(camera, 20, 0.2, seed=10)
    names = camera.parameter_names
    longer = np.where([name == "f_m" for name in names], 1.02, 1.0) * camera.parameters
    there = residual.bind(stars, camera.with_parameters(longer)).linearise(camera)[:, -1]
    here = residual.bind(stars, camera).linearise(camera)[:, -1]
    assert np.linalg.norm(there) == pytest.approx(np.linalg.norm(here), rel=1e-3)


@pytest.mark.parametrize("model", SENSORS)
def test_information_of_each_residual(model):
    """Arclengths hold all that directions do; singular values and their parts hold less."""
    camera, steps = camera_of(model), SENSORS[model][2]
    stars = scene(camera, 60, 0.2, seed=6, counts=(5, 12))
    full = normal_matrix(Residual("direction"), stars, camera, steps)

    def share(residual):
        """Smallest and largest information along any direction, over the full."""
        part = normal_matrix(residual, stars, camera, steps)
        ratio = np.linalg.eigvals(np.linalg.solve(full, part)).real
        return ratio.min(), ratio.max()

    assert share(Residual("arclength"))[0] > 0.985
    assert share(Residual("arclength"))[1] < 1.005
    growing = share(Residual("singular-values", 4, (2, 3)))
    assert 0.2 < growing[0] < 1.0
    assert growing[1] < 1.01
    # The three values are dependent; one of them alone says less than two.
    three = normal_matrix(Residual("singular-values", 4, (1, 2, 3)), stars, camera, steps)
    two = normal_matrix(Residual("singular-values", 4, (2, 3)), stars, camera, steps)
    ratio = np.linalg.eigvals(np.linalg.solve(two, three)).real
    np.testing.assert_allclose(ratio, 1.0, atol=0.05)
    one = normal_matrix(Residual("singular-values", 4, (3,)), stars, camera, steps)
    assert np.linalg.eigvals(np.linalg.solve(two, one)).real.max() < 1.001


@pytest.mark.parametrize("model", SENSORS)
def test_directions_leave_what_wahbas_best_attitude_leaves(model):
    camera = camera_of(model)
    stars = scene(camera, 20, 0.2, seed=7)
    rows = Residual("direction").bind(stars, camera).linearise(camera)
    sd = stars.sd_px * camera.noise_scale(stars.row_px, stars.col_px)
    s_d = camera.directions(stars.row_px, stars.col_px)
    expected = 0.0
    for a, b in itertools.pairwise(stars.offsets):
        # scipy's loss is the root of the sum of weighted squared chords.
        _, loss = Rotation.align_vectors(stars.s_i[a:b], s_d[a:b], weights=1.0 / sd[a:b] ** 2)
        expected += loss**2
    assert np.sum(rows[:, -1] ** 2) == pytest.approx(expected, rel=1e-4)
    assert len(rows) == np.sum(2 * np.diff(stars.offsets) - 3)


def groups_of(model, stars):
    """Wu 2019, section 3.3.2, written out."""
    if model == 1:
        return [range(k, k + 3) for k in range(stars - 2)]
    if model == 2:
        size = max(stars // 2, 3)
        return [range(k, k + size) for k in range(stars - size + 1)]
    if model == 3:
        return [range(k, k + stars - 1) for k in range(2)]
    return [range(k) for k in range(3, stars + 1)]


@pytest.mark.parametrize("values", [(2, 3), (1, 2), (3,)])
@pytest.mark.parametrize("model", [1, 2, 3, 4])
def test_singular_values_are_numpys_whitened_by_numpy(model, values):
    """chi2 of the whitened rows is that of numpy's values under their propagated covariance."""
    camera = camera_of("wang")
    stars = scene(camera, 1, 0.02, seed=8, counts=(6, 7))
    bound = Residual("singular-values", model, values).bind(stars, camera)
    s_d = camera.directions(stars.row_px, stars.col_px)
    sd = stars.sd_px * camera.noise_scale(stars.row_px, stars.col_px)
    groups = groups_of(model, 6)
    which = np.array(values) - 1

    def values_of(s):
        return np.concatenate([np.linalg.svd(s[list(g)], compute_uv=False)[which] for g in groups])

    tangent = []
    for k, s in enumerate(stars.s_i):
        for t in np.linalg.svd(s[None])[2][1:]:
            moved = [np.array(stars.s_i), np.array(stars.s_i)]
            for sign, m in zip((1e-4, -1e-4), moved, strict=True):
                m[k] = (s + sign * t) / np.linalg.norm(s + sign * t)
            tangent.append(sd[k] * (values_of(moved[0]) - values_of(moved[1])) / 2e-4)
    slope = np.array(tangent)
    covariance = slope.T @ slope
    r = values_of(s_d) - values_of(stars.s_i)
    assert bound.size == len(r)
    kept = bound.linearise(camera)[:, :-1].any(axis=1)
    expected = r[kept] @ np.linalg.solve(covariance[np.ix_(kept, kept)], r[kept])
    assert kept.sum() >= len(r) - 2
    assert np.sum(bound.linearise(camera)[:, -1] ** 2) == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("residual", ALL, ids=named)
def test_an_attitude_changes_nothing(residual):
    """Turning the catalogue by any rotation leaves every residual what it was."""
    camera = camera_of("wang")
    stars = scene(camera, 8, 0.2, seed=9)
    turn = Rotation.from_rotvec([1.0, -2.0, 0.5])
    turned = StarSelection(
        stars.star, stars.exposure, stars.row_px, stars.col_px, turn.apply(stars.s_i),
        stars.sd_px, stars.n_exposures,
    )  # fmt: skip
    before, after = (np.sum(residual.bind(s, camera).linearise(camera)[:, -1] ** 2)
                     for s in (stars, turned))  # fmt: skip
    assert after == pytest.approx(before, rel=1e-5)


@pytest.mark.parametrize(
    ("residual", "reason"),
    [
        (Residual("cosines"), "no residual 'cosines'"),
        (Residual("singular-values", 5), "groups 5"),
        (Residual("singular-values", 4, ()), "values"),
        (Residual("singular-values", 4, (2, 2)), "values"),
        (Residual("singular-values", 4, (0, 2)), "values"),
    ],
)
def test_options_that_there_are_not_are_refused(residual, reason):
    with pytest.raises(UsageError, match=reason):
        residual.check()
