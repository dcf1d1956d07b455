"""Measurement and time updates of the sequential estimators (numba).

All share one form.  State x (n,) with a square ``root`` (n, n) of their own kind; measurements are
whitened rows [H | y] (A, n + 1), so that y = H d + v with d the step of the state and v of unit
variance: rows are processed one scalar at a time.  ``innovation`` (A,) is filled with standardised
innovations, independent and of unit variance when the filter is consistent; ``score`` (2,) with
their sum of squares (NIS) and the logarithm of the determinant of the innovation covariance.

Every kernel computes in the precision of the arrays that it is given.
"""

from __future__ import annotations

import math

import numpy as np

from stcal.jit import kernel


@kernel
def conventional_update(rows, x, covariance, innovation, score):
    """Kalman update with the covariance itself, Enright 2018 eqs (25)-(27).

    With R = 1 the vector update equals scalar updates one after the other.  The subtraction in
    (27) loses the covariance's positive definiteness in short arithmetic: see ``carlson_update``.
    Where it is lost altogether, state and score become NaN.
    """
    n = x.shape[0]
    step, gain = np.zeros_like(x), np.empty_like(x)
    one = rows.dtype.type(1.0)
    score[:] = 0.0
    for a in range(rows.shape[0]):
        alpha, z = one, rows[a, n]
        for i in range(n):
            gain[i] = rows.dtype.type(0.0)
            for j in range(n):
                gain[i] += covariance[i, j] * rows[a, j]
            alpha += rows[a, i] * gain[i]
            z -= rows[a, i] * step[i]
        if not alpha > 0.0:
            x[:], innovation[:], score[:] = math.nan, math.nan, math.nan
            return
        for i in range(n):
            step[i] += gain[i] * (z / alpha)
            for j in range(n):
                covariance[i, j] -= gain[i] / alpha * gain[j]
        innovation[a] = z / math.sqrt(alpha)
        score[0] += innovation[a] * innovation[a]
        score[1] += math.log(alpha)
    for i in range(n):
        x[i] += step[i]


@kernel
def carlson_update(rows, x, root, innovation, score):
    """Carlson's triangular square-root update, Enright 2018 eqs (83)-(87) with f = S^T h in (87).

    ``root`` is S^T, upper triangular, P = S S^T: rows are contiguous then.  It stays triangular
    when columns of S are taken from the last to the first (Carlson 1973; Grewal & Andrews 2001
    have the other form).
    """
    n = x.shape[0]
    step, w, f = np.zeros_like(x), np.empty_like(x), np.empty_like(x)
    alpha = np.empty(n + 1, x.dtype)
    one, zero = rows.dtype.type(1.0), rows.dtype.type(0.0)
    score[:] = 0.0
    for a in range(rows.shape[0]):
        z = rows[a, n]
        for i in range(n):
            z -= rows[a, i] * step[i]
            w[i] = zero
        total = alpha[n] = one
        for j in range(n - 1, -1, -1):
            dot = zero
            for i in range(j, n):
                dot += root[j, i] * rows[a, i]
            total += dot * dot
            f[j], alpha[j] = dot, total
        for j in range(n - 1, -1, -1):
            dot, scale = f[j], one / math.sqrt(alpha[j] * alpha[j + 1])
            eta, zeta = alpha[j + 1] * scale, dot * scale
            # Over the zeros too: loops of one length are compiled to vector instructions.
            for i in range(n):
                old = root[j, i]
                root[j, i] = eta * old - zeta * w[i]
                w[i] += old * dot
        gain = z / total
        for i in range(n):
            step[i] += w[i] * gain
        innovation[a] = z / math.sqrt(total)
        score[0] += innovation[a] * innovation[a]
        score[1] += math.log(total)
    for i in range(n):
        x[i] += step[i]


@kernel
def information_update(rows, x, root, innovation, score):
    """Square-root information update by Givens rotations (Bierman 1977, chapter V).

    ``root`` is the upper triangular R of P^-1 = R^T R, referred to x itself: R d = 0 at the start.
    """
    n = x.shape[0]
    right = np.zeros_like(x)
    row = np.empty(n + 1, rows.dtype)
    score[:] = 0.0
    for k in range(n):
        score[1] -= 2.0 * math.log(root[k, k])
    for a in range(rows.shape[0]):
        row[:] = rows[a]
        for k in range(n):
            if row[k] == 0.0:
                continue
            length = math.sqrt(root[k, k] * root[k, k] + row[k] * row[k])
            cosine, sine = root[k, k] / length, row[k] / length
            for j in range(k, n):
                above = root[k, j]
                root[k, j] = cosine * above + sine * row[j]
                row[j] = cosine * row[j] - sine * above
            above = right[k]
            right[k] = cosine * above + sine * row[n]
            row[n] = cosine * row[n] - sine * above
        innovation[a] = row[n]
        score[0] += innovation[a] * innovation[a]
    for k in range(n):
        score[1] += 2.0 * math.log(root[k, k])
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            right[k] -= root[k, j] * right[j]
        right[k] /= root[k, k]
    for k in range(n):
        x[k] += right[k]


@kernel
def sigma_points(x, root, points):
    """Fill ``points`` (2 n + 1, n): x, and x plus and minus sqrt(n) columns of S (rows of root).

    The scaled transform with alpha = 1, kappa = 0 (lambda = 0): no weight is negative, so that the
    covariance can't become indefinite.
    """
    n = x.shape[0]
    spread = math.sqrt(x.dtype.type(n))
    points[0] = x
    for k in range(n):
        for i in range(n):
            points[1 + k, i] = x[i] + spread * root[k, i]
            points[1 + n + k, i] = x[i] - spread * root[k, i]


@kernel
def unscented_update(values, x, root, innovation, score):
    """Unscented update from whitened residuals at the sigma points, ``values`` (A, 2 n + 1).

    With X and Y the weighted deviations of states and residuals, the state is x + X w, w of unit
    covariance, and the residuals are linear in w: Carlson's update of w gives the gain and the new
    root in one pass, without an A x A matrix.
    """
    n, count = x.shape[0], values.shape[1]
    weight = values.dtype.type(1.0 / (2.0 * n))
    # Weight of the centre's square: beta = 2 suits a normal distribution.
    centre = math.sqrt(values.dtype.type(2.0))
    side, spread = math.sqrt(weight), math.sqrt(x.dtype.type(n))
    rows = np.empty((values.shape[0], count + 1), values.dtype)
    for a in range(values.shape[0]):
        mean = values.dtype.type(0.0)
        for k in range(1, count):
            mean += weight * values[a, k]
        rows[a, 0] = centre * (values[a, 0] - mean)
        for k in range(1, count):
            rows[a, k] = side * (values[a, k] - mean)
        rows[a, count] = -mean
    w, turn = np.zeros(count, x.dtype), np.eye(count).astype(x.dtype)
    carlson_update(rows, w, turn, innovation, score)
    stacked = np.zeros((count, n), x.dtype)
    for i in range(n):
        for k in range(n):
            deviation = side * spread * root[k, i]
            x[i] += deviation * (w[1 + k] - w[1 + n + k])
            for j in range(count):
                stacked[j, i] += deviation * (turn[j, 1 + k] - turn[j, 1 + n + k])
    triangularise(stacked)
    for i in range(n):
        for j in range(i, n):
            root[i, j] = stacked[i, j]


@kernel
def triangularise(stacked):
    """Turn ``stacked`` (m, n), m >= n, to upper triangular form in place, by Householder's QR.

    The diagonal comes out positive; what lies below it is not cleared.
    """
    m, n = stacked.shape
    for k in range(n):
        norm2 = stacked.dtype.type(0.0)
        for i in range(k, m):
            norm2 += stacked[i, k] * stacked[i, k]
        norm = math.sqrt(norm2)
        if norm == 0.0:
            continue
        sign = stacked.dtype.type(-1.0) if stacked[k, k] < 0.0 else stacked.dtype.type(1.0)
        stacked[k, k] += sign * norm
        scale = sign * norm * stacked[k, k]
        for j in range(k + 1, n):
            dot = stacked.dtype.type(0.0)
            for i in range(k, m):
                dot += stacked[i, k] * stacked[i, j]
            for i in range(k, m):
                stacked[i, j] -= stacked[i, k] * (dot / scale)
        stacked[k, k] = norm
        for j in range(k + 1, n):
            # Householder gives -sign * norm on the diagonal: flip the row to make it positive.
            stacked[k, j] *= -sign


@kernel
def conventional_predict(covariance, noise_sd):
    """P + Q with Q diagonal, Enright 2018 eq (29); ``noise_sd`` (n,) are the roots of Q."""
    for k in range(noise_sd.shape[0]):
        covariance[k, k] += noise_sd[k] * noise_sd[k]


@kernel
def root_predict(root, noise_sd):
    """S of P + Q by QR of the stacked factors: what eq (88) has to be."""
    n = noise_sd.shape[0]
    stacked = np.zeros((2 * n, n), root.dtype)
    for i in range(n):
        for j in range(i, n):
            stacked[i, j] = root[i, j]
        stacked[n + i, i] = noise_sd[i]
    triangularise(stacked)
    for i in range(n):
        for j in range(i, n):
            root[i, j] = stacked[i, j]
