"""Strength of a tag's signal at a reader: path loss with distance, shadowing, noise."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.sight.path_loss import received_power


class PathLoss(NamedTuple):
    """The model of R readers: a strength is power - 10 exponent log10(d / 1 m) + shadowing + noise [dBm].

    Shadowing is a stationary Ornstein-Uhlenbeck process of each reader; noise is white.
    """

    places: Floats  # (R, 3)
    power: Floats  # (R,) strength at 1 m [dBm]
    exponent: float
    noise_db: float  # standard deviation of the noise of a read
    shadow_db: float  # standard deviation of the shadowing
    shadow_s: float  # time in which it is forgotten
    height: float  # of the tags
    metre: float  # in units of length

    def expected(self, xy: Floats) -> Floats:
        """(N, R) strength without shadowing and noise [dBm] of tags at (N, 2)."""
        across = ((xy[:, None, :] - self.places[None, :, :2]) ** 2).sum(axis=2)
        distance = np.sqrt(across + (self.places[:, 2] - self.height) ** 2) / self.metre
        return received_power(self.power, self.exponent, distance)

    def strength_at(self, distance: float) -> Floats:
        """(R,) strength [dBm] expected at a distance."""
        return received_power(self.power, self.exponent, distance / self.metre)


class Shadowing(NamedTuple):
    """What is known of the shadowing of R readers, for each of N hypotheses of where a tag is.

    The variance does not depend on the hypothesis, since it does not depend on the strengths.
    """

    mean: Floats  # (N, R) [dB]
    variance: Floats  # (R,) [dB^2]


def no_shadowing(model: PathLoss, hypotheses: int) -> Shadowing:
    """Begin with the stationary distribution."""
    readers = len(model.power)
    return Shadowing(np.zeros((hypotheses, readers)), np.full(readers, model.shadow_db**2))


def predict_shadowing(model: PathLoss, known: Shadowing, dt_s: float) -> Shadowing:
    """Predict over `dt_s` seconds: the mean decays, the variance goes to the stationary one."""
    decay = np.exp(-dt_s / model.shadow_s)
    variance = decay**2 * known.variance + model.shadow_db**2 * (1.0 - decay**2)
    return Shadowing(decay * known.mean, variance)


def update_shadowing(
    model: PathLoss, known: Shadowing, expected: Floats, rssi: Floats, count: Ints
) -> tuple[Shadowing, Floats]:
    """Kalman update with mean strengths of a window.

    Args:
        model: of the readers.
        known: before the window.
        expected: (N, R) strengths by the distance of each hypothesis.
        rssi: (R,) mean strengths; NaN: none.
        count: (R,) reads that each is the mean of.

    Returns:
        What is known afterwards, and the (N,) log-likelihood of the strengths.
    """
    told: Bools = np.isfinite(rssi)
    # Innovation, its variance, gain
    innovation = np.where(told, np.where(told, rssi, 0.0) - expected - known.mean, 0.0)
    spread = known.variance + model.noise_db**2 / np.maximum(count, 1)
    gain = np.where(told, known.variance / spread, 0.0)
    log_likelihood = -0.5 * (innovation**2 / spread + np.where(told, np.log(2.0 * np.pi * spread), 0.0)).sum(axis=1)
    return Shadowing(known.mean + gain * innovation, (1.0 - gain) * known.variance), log_likelihood
