"""Messages along a track against the joint Gaussian density of all its measurements."""

import numpy as np
import pytest

from occlog.track.methods.jipda.batch.gaussian_messages import (
    initial_density,
    log_integral,
    multiply_factor,
    noise_of_walk,
    predict,
    predict_backwards,
)

DRIFT = np.array([0.06, 1e-3, 1e-3])
PRIOR = np.array([0.0, 0.0, 1.2, 1.2, 60.0, 70.0])
AT = np.array([0.0, 0.0, 0.1, -0.2, 1.7, 0.5])
TIMES = np.array([0.0, 0.5, 0.7, 2.0])
WIDE = 1e4
"""Standard deviation of a place that stands for a uniform one."""


def walk(dt):
    F, Q = np.eye(6), np.empty((6, 6))
    F[0, 2] = F[1, 3] = dt
    noise_of_walk(dt, DRIFT, Q)
    return F, Q


def measured(seed=0):
    """Factors of four linear measurements of the place, height and width, and what they were made of."""
    rng = np.random.default_rng(seed)
    H, R, z = [], [], []
    for k in range(len(TIMES)):
        h = np.zeros((4, 6))
        h[:, [0, 1, 4, 5]] = np.eye(4) + 0.2 * rng.normal(size=(4, 4))
        r = np.diag(rng.uniform(0.01, 0.04, 4))
        H.append(h)
        R.append(r)
        z.append(h @ np.array([0.4 * TIMES[k], 0.3, 0.0, 0.0, 1.75, 0.55]) + rng.normal(0.0, 0.1, 4))
    J = np.array([h.T @ np.linalg.inv(r) @ h for h, r in zip(H, R, strict=True)])
    v = np.array([h.T @ np.linalg.inv(r) @ x for h, r, x in zip(H, R, z, strict=True)])
    c = np.array(
        [-0.5 * x @ np.linalg.inv(r) @ x - 0.5 * np.linalg.slogdet(2 * np.pi * r)[1] for r, x in zip(R, z, strict=True)]
    )
    return H, R, z, J, v, c


def joint_log_density(H, R, z):
    """Log density of all measurements under the walk, times the area over which the first place is uniform."""
    P = np.diag([WIDE**2, WIDE**2, *(1.0 / PRIOR[2:])])
    means, blocks = [AT], {(0, 0): P}
    for k in range(1, len(TIMES)):
        F, Q = walk(TIMES[k] - TIMES[k - 1])
        means.append(F @ means[-1])
        for a in range(k):
            blocks[a, k] = blocks[a, k - 1] @ F.T
            blocks[k, a] = blocks[a, k].T
        blocks[k, k] = F @ blocks[k - 1, k - 1] @ F.T + Q
    n = len(TIMES)
    S = np.block([[H[a] @ blocks[a, b] @ H[b].T + (R[a] if a == b else 0.0) for b in range(n)] for a in range(n)])
    off = np.concatenate([z[k] - H[k] @ means[k] for k in range(n)])
    value = -0.5 * off @ np.linalg.solve(S, off) - 0.5 * np.linalg.slogdet(2 * np.pi * S)[1]
    return value + np.log(2 * np.pi * WIDE**2)


def forward(J, v, c, upto):
    mean, P = np.empty(6), np.empty((6, 6))
    total = initial_density(PRIOR, AT, J[0], v[0], c[0], mean, P)
    for k in range(1, upto + 1):
        m, Q = np.empty(6), np.empty((6, 6))
        predict(mean, P, TIMES[k] - TIMES[k - 1], DRIFT, m, Q)
        mean, P = m, Q
        total += multiply_factor(mean, P, J[k], v[k], c[k])
    return mean, P, total


def backward(J, v, c, downto):
    Jb, vb, total = J[-1].copy(), v[-1].copy(), c[-1]
    for k in range(len(TIMES) - 2, downto - 1, -1):
        out_J, out_h = np.empty((6, 6)), np.empty(6)
        total = predict_backwards(Jb, vb, total, TIMES[k + 1] - TIMES[k], DRIFT, out_J, out_h) + c[k]
        Jb, vb = out_J + J[k], out_h + v[k]
    return Jb, vb, total


def test_the_filter_gives_the_density_of_all_measurements():
    H, R, z, J, v, c = measured()
    assert forward(J, v, c, 3)[2] == pytest.approx(joint_log_density(H, R, z), abs=1e-4)


@pytest.mark.parametrize("at", [0, 1, 2])
def test_the_messages_give_the_same_density_at_every_link(at):
    *_, J, v, c = measured(1)
    mean, P, past = forward(J, v, c, at)
    m, Q = np.empty(6), np.empty((6, 6))
    predict(mean, P, TIMES[at + 1] - TIMES[at], DRIFT, m, Q)
    Jb, vb, future = backward(J, v, c, at + 1)
    assert past + log_integral(m, Q, Jb, vb, future) == pytest.approx(forward(J, v, c, 3)[2], abs=1e-6)


def test_a_track_that_starts_with_everything_that_follows_has_the_same_density():
    *_, J, v, c = measured(2)
    Jb, vb, future = backward(J, v, c, 0)
    mean, P = np.empty(6), np.empty((6, 6))
    assert initial_density(PRIOR, AT, Jb, vb, future, mean, P) == pytest.approx(forward(J, v, c, 3)[2], abs=1e-6)
