"""Error of the body model that is common to all cameras: what it adds to the covariances of positions.

Bodies differ from the model, so that the middles of all boxes are too high or too low by a share of the height.
Cameras around a person find the bias, and it hardly moves the position; cameras on one side do not, and all positions
are too near or too far.  A consider parameter (Schmidt 1966): it is not estimated here, but is part of the covariance.
"""

from __future__ import annotations

import numpy as np

from occlog.array_types import Floats

PRIOR_SIGMA = 0.02
"""Standard deviation of the bias before any box, in heights."""
SPELL_S, SPELL_SIGMA = 5.0, 0.03
"""People whom cameras see from all sides for this time [s] give the bias with this standard deviation, in heights."""


def bias_information(share: Floats, dt: float) -> float:
    """Return the information on the bias of people who are seen for dt seconds; `share` (n,) of `body_bias_shift`."""
    return float((1.0 - share**2).sum()) * dt / SPELL_S / SPELL_SIGMA**2


def with_body_bias(covariance: Floats, shift: Floats, information: float) -> Floats:
    """Return the covariances (n, 6, 6) with the bias, of which people move by `shift` (n, 2)."""
    out = covariance.copy()
    out[:, :2, :2] += shift[:, :, None] * shift[:, None, :] / (1.0 / PRIOR_SIGMA**2 + information)
    return np.asarray(out)
