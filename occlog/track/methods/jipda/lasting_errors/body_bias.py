"""Error of the body model that is common to all cameras: its variance, and its effect on covariances of positions.

If a body differs from the model, the centres of its boxes are too high or too low by a share of the height in all
cameras. Cameras around a person determine this bias, which then hardly affects the position; with cameras on one side
all positions are too near or too far. It is a consider parameter (Schmidt 1966): not estimated here, but included in
the covariance.
"""

from __future__ import annotations

import numpy as np

from occlog.array_types import Floats

PRIOR_SIGMA = 0.02
"""Standard deviation of the bias before any box, in heights."""
SPELL_S, SPELL_SIGMA = 5.0, 0.03
"""People whom cameras see from all sides for this time [s] give the bias with this standard deviation, in heights."""


def bias_information(share: Floats, dt: float) -> float:
    """Return the information (inverse variance, in box heights^-2) about the body bias gained in `dt` seconds.

    `share` (n,) of each tracked person, from `bias_effects`, is 1 if all cameras are on one side and less the better
    they surround the person; the information is in proportion to the sum of 1 - share^2.
    """
    return float((1.0 - share**2).sum()) * dt / SPELL_S / SPELL_SIGMA**2


def with_biases(covariance: Floats, shift: Floats, information: float, poses: Floats) -> Floats:
    """Return a copy of state covariances (n, 6, 6) with the variances of body bias and camera poses added to x and y.

    `shift` (n, 2) is how far x and y move per unit of bias, `information` the learned inverse variance of the bias, to
    which that of the prior is added, and `poses` (n, 2, 2) the covariance of x and y due to the poses.
    """
    out = covariance.copy()
    out[:, :2, :2] += shift[:, :, None] * shift[:, None, :] / (1.0 / PRIOR_SIGMA**2 + information) + poses
    return np.asarray(out)
