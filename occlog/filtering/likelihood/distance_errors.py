"""Errors of measurements of distances: Gaussian ones, signals that came by a detour, and false ones.

With u the residual in standard deviations, a value of a range has the density

    f(u) = (1 - w) N(u; 0, 1) + w E(u) + N(k; 0, 1),
    E(u) = l exp(l^2 / 2 - l u) Phi(u - l),   l = sigma / L,

E the sum of a standard normal and an exponential of mean L / sigma: an exponentially modified Gaussian (Grushka 1972).
A share w of the signals has no free path and comes later by a length of mean L, never earlier.  Of a difference the
signal at either station may be late: with d the chance (1 - w)^2 neither is, and since the difference of two equal
exponentials has an exponential tail on each side, E(u) and E(-u) have (1 - d) / 2 each.  A strength cannot be late.

N(k) is the constant of values that are false (another's pulse): at k standard deviations, on the side that no detour
explains, a value is as likely false as true.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr

from occlog.array_types import Floats

LOG_ROOT_2PI = 0.5 * math.log(2.0 * math.pi)
MOST = 700.0
"""Exponents are not above this."""


class Errors(NamedTuple):
    """How m measurements err; arrays of (m,)."""

    bend: Floats  # k, > 0
    late: Floats  # chance of E(u), 0 to 1
    early: Floats  # chance of E(-u)
    rate: Floats  # l, > 0

    @property
    def tailed(self) -> bool:
        """Whether any signal may come by a detour."""
        return bool(self.late.any() or self.early.any())

    def widened(self, variance: Floats) -> Errors:
        """Of residuals divided by the root of a variance (..., m), which the place adds to that of the noise."""
        return self._replace(rate=self.rate * np.sqrt(variance))


class Pull(NamedTuple):
    """How measurements pull at an estimate, of the shape of their residuals."""

    slope: Floats  # derivative of -log f by u
    weight: Floats  # curvature that counts: 1 of a value without a detour, 0 to 1 of one that has it, 0 of a false one
    direct: Floats  # probability that a value is neither false nor came by a detour


def without_detours(bend: Floats) -> Errors:
    """Errors of measurements (m,) that are Gaussian or false."""
    none = np.zeros(len(bend))
    return Errors(bend, none, none, np.ones(len(bend)))


def log_density(u: Floats, errors: Errors, variance: Floats | float = 1.0) -> Floats:
    """Log of sqrt(2 pi) f(u), (..., m).

    Args:
        u: (..., m) residuals in standard deviations.
        errors: of the m measurements.
        variance: (..., m) of the Gaussian part, in units of that of the noise, where the place is uncertain besides.
    """
    false = -0.5 * errors.bend**2
    gauss = -0.5 * u**2 / variance - 0.5 * np.log(variance)
    if not errors.tailed:
        return np.asarray(np.logaddexp(gauss, false))
    late, early = _tails(u, errors, variance)
    return np.asarray(np.logaddexp(np.logaddexp(_log_direct(errors) + gauss, false), np.logaddexp(late, early)))


def direct(u: Floats, errors: Errors) -> Floats:
    """(..., m) probability that values with residuals (..., m) are neither false nor came by a detour."""
    own = _log_direct(errors) - 0.5 * u**2
    others = np.broadcast_to(-0.5 * errors.bend**2, np.shape(own))
    if errors.tailed:
        others = np.logaddexp(others, np.logaddexp(*_tails(u, errors, 1.0)))
    return np.asarray(1.0 / (1.0 + np.exp(np.minimum(others - own, MOST))))


def pull(u: Floats, errors: Errors) -> Pull:
    """What residuals (..., m) do to an estimate.

    The curvature is the expectation of those of the parts (direct, late, false), which is not below 0; what not
    knowing which part it is takes away is left out, as usual in iteratively reweighted least squares.
    """
    own = direct(u, errors)
    if not errors.tailed:
        return Pull(own * u, own, own)
    whole = log_density(u, errors)
    late, early = (np.exp(part - whole) for part in _tails(u, errors, 1.0))
    after, after_bend = _tail_pull(u, errors.rate)
    before, before_bend = _tail_pull(-u, errors.rate)
    return Pull(own * u + late * after - early * before, own + late * after_bend + early * before_bend, own)


def _log_direct(errors: Errors) -> Floats:
    return np.log1p(-np.minimum(errors.late + errors.early, 1.0 - 1e-12))


def _tails(u: Floats, errors: Errors, variance: Floats | float) -> tuple[Floats, Floats]:
    """Logs of sqrt(2 pi) times the parts of late and of early signals; -inf where there are none."""
    with np.errstate(divide="ignore"):
        late, early = np.log(errors.late), np.log(errors.early)
    return late + _log_tail(u, errors.rate, variance), early + _log_tail(-u, errors.rate, variance)


def _log_tail(u: Floats, rate: Floats, variance: Floats | float) -> Floats:
    """Log of sqrt(2 pi) E(u), with a variance of the Gaussian."""
    root = np.sqrt(variance)
    return np.asarray(
        LOG_ROOT_2PI + np.log(rate) + 0.5 * rate**2 * variance - rate * u + log_ndtr(u / root - rate * root)
    )


def _tail_pull(u: Floats, rate: Floats) -> tuple[Floats, Floats]:
    """First and second derivative of -log E by u: l - h and h (h + t), with t = u - l and h = N(t) / Phi(t)."""
    t = u - rate
    h = np.exp(-0.5 * t**2 - LOG_ROOT_2PI - log_ndtr(t))
    return rate - h, np.clip(h * (h + t), 0.0, 1.0)
