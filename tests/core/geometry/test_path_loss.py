"""The log-distance path loss: its formula, its limit, and its inverse."""

from __future__ import annotations

import numpy as np

from occlog.core.geometry.path_loss import log_distance, received_power


def test_a_strength_falls_by_ten_exponents_a_decade_from_a_tenth_of_a_metre_on() -> None:
    metres = np.array([0.0, 0.05, 0.1, 0.2, 1.0, 10.0])
    wanted = -55.0 - 18.0 * np.log10([0.1, 0.1, 0.1, 0.2, 1.0, 10.0])
    np.testing.assert_allclose(received_power(-55.0, 1.8, metres), wanted)


def test_a_strength_says_the_distance_that_it_comes_from() -> None:
    metres = np.array([0.5, 3.0, 20.0])
    rssi, sigma_db, power = received_power(-55.0, 1.8, metres), np.array([2.0, 4.0, 5.0]), np.full(3, -55.0)
    value, sigma = log_distance(rssi, sigma_db, power, 1.8)
    np.testing.assert_allclose(np.exp(value), metres, rtol=1e-12)
    # One standard deviation less in strength is one more in the logarithm
    weaker, _ = log_distance(rssi - sigma_db, sigma_db, power, 1.8)
    np.testing.assert_allclose(weaker - value, sigma, rtol=1e-12)
