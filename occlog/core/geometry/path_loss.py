"""Strength of a radio signal with distance: the log-distance path loss."""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Floats

NEAREST_M = 0.1
"""The model does not hold for shorter distances [m]."""


def received_power(power: float | Floats, exponent: float, metres: float | Floats) -> Floats:
    """Return the mean strength of a radio signal, power - 10 exponent log10(d) [dBm], without shadowing and noise.

    Args:
        power: strength at 1 m [dBm], one or of the shape of `metres`.
        exponent: exponent of the path loss.
        metres: distances d [m]; those below `NEAREST_M` are taken as `NEAREST_M`.
    """
    return np.asarray(power - 10.0 * exponent * np.log10(np.maximum(metres, NEAREST_M)))


def log_distance(rssi: Floats, sigma_db: Floats, power: Floats, exponent: float) -> tuple[Floats, Floats]:
    """Return the natural logarithm of the distance [m] at which a strength is expected, and its standard deviation.

    Both have the shape (m,).

    It is the inverse of `received_power`, so that a strength with Gaussian noise is a logarithm with Gaussian noise.

    Args:
        rssi: (m,) strengths [dBm].
        sigma_db: (m,) their standard deviations [dB].
        power: (m,) strengths at 1 m [dBm].
        exponent: exponent of the path loss, > 0.
    """
    scale = math.log(10.0) / (10.0 * exponent)
    return scale * (power - rssi), scale * sigma_db
