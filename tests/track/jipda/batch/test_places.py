"""Factors of people whose place is spread about their walk."""

import numpy as np

from occlog.track.methods.jipda.batch.gaussian_messages import log_integral
from occlog.track.methods.jipda.batch.tracklet_nodes import widen_by_gait


def test_the_mean_over_the_spread_is_that_of_a_wider_density():
    rng = np.random.default_rng(0)
    A = rng.normal(size=(6, 6))
    J, h, c = (A @ A.T + np.eye(6))[None], rng.normal(size=(1, 6)), np.array([0.3])
    mean, P, sway = rng.normal(size=6), np.diag(rng.uniform(0.1, 0.4, 6)), 0.2
    out_J, out_h, out_c = np.empty_like(J), np.empty_like(h), np.empty_like(c)
    widen_by_gait(J, h, c, np.array([sway]), out_J, out_h, out_c)
    wide = P.copy()
    wide[[0, 1], [0, 1]] += sway
    assert np.isclose(log_integral(mean, P, out_J[0], out_h[0], out_c[0]), log_integral(mean, wide, J[0], h[0], c[0]))
