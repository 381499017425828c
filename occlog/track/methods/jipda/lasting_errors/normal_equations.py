"""Least squares with time-correlated errors.

Solution of normal equations in batches of time, with significance limits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from occlog.array_types import NS, Floats

BATCH_S = 0.5
"""Duration of a batch [s]."""
MAX_BATCHES = 120
"""Number of batches that count, the last ones: clocks drift, and cameras are touched."""
MIN_BATCHES = 8
"""Minimum number of batches that say something of a parameter, for an estimate."""
LAG_SHARE = 0.25
"""Share of the batches over which errors are correlated."""
FALSE_PROBABILITY = 1e-6
"""Probability of a significant parameter by chance."""


@dataclass(frozen=True)
class Batches:
    """Sums of normal equations N p = b of K parameters in batches of time of `BATCH_S`, each as rows (N, b).

    `kept` (B, K, K + 1) are the last complete batches in the order of time, `open` (K, K + 1) the sum of the current
    one, which began at `since_ns` (-1: no data).
    """

    kept: Floats  # (B, K, K + 1) complete batches, in the order of time
    open: Floats  # (K, K + 1) of the batch that is not complete
    since_ns: int = -1  # its begin; -1: none

    @classmethod
    def of(cls, parameters: int) -> Batches:
        """Return sums of normal equations without data, for K = `parameters` parameters."""
        none = np.zeros((parameters, parameters + 1))
        return cls(none[None][:0], none)

    def add(self, t_ns: int, normal: Floats) -> Batches:
        """Return the sums with the normal equations of a time step at `t_ns` added.

        `normal` (K, K + 1) are rows (N, b) of N p = b. A batch that has lasted `BATCH_S` is complete with this time
        step: the next one begins at `t_ns`; of complete batches the last `MAX_BATCHES` are kept.
        """
        since = t_ns if self.since_ns < 0 else self.since_ns
        total = self.open + normal
        if t_ns - since < BATCH_S * NS:
            return Batches(self.kept, total, since)
        return Batches(np.concatenate([self.kept, total[None]])[-MAX_BATCHES:], np.zeros_like(total), t_ns)


def solve_batches(batches: Floats, prior_precision: float = 0.0) -> tuple[Floats, Floats]:
    """Solve normal equations N p = b summed over batches; return K parameters and their significance limits.

    The variance allows for errors that are correlated between batches (`newey_west`).

    Args:
        batches: (B, K, K + 1) rows (N, b) of each batch, in the order of time.
        prior_precision: prior precision of each parameter about 0.

    Returns:
        (K,) parameters, by the pseudo-inverse, 0 if not estimated; (K,) the size at which each would be significant at
        the level `FALSE_PROBABILITY`, by Student's t; inf: fewer than `MIN_BATCHES` batches have information on it.
    """
    N, b = batches[..., :-1], batches[..., -1]
    K, B = b.shape[1], len(b)
    seen = (np.einsum("bkk->bk", N) > 0.0).sum(axis=0) >= MIN_BATCHES
    p, limit = np.zeros(K), np.full(K, np.inf)
    if not seen.any():
        return p, limit
    N, b = N[:, seen][:, :, seen], b[:, seen]
    inverse = np.linalg.pinv(N.sum(axis=0) + prior_precision * np.eye(len(N[0])), hermitian=True)
    solution = inverse @ b.sum(axis=0)
    variance = newey_west((b - N @ solution) @ inverse)
    p[seen] = solution
    limit[seen] = -float(stdtrit(B - 1.0, 0.5 * FALSE_PROBABILITY)) * np.sqrt(variance * B / (B - 1.0))
    return p, limit


def newey_west(off: Floats) -> Floats:
    """Return variances (K,) of the column sums of correlated batches `off` (B, K), no smaller than if uncorrelated.

    Newey and West (1987): lags up to the share `LAG_SHARE` of the number of batches, with Bartlett weights.
    """
    B = len(off)
    variance = (off**2).sum(axis=0)
    out = variance.copy()
    lags = max(round(LAG_SHARE * B), 1)
    for lag in range(1, min(lags + 1, B)):
        weight = 1.0 - lag / (lags + 1.0)
        out += 2.0 * weight * (off[lag:] * off[:-lag]).sum(axis=0)
    return np.asarray(np.maximum(out, variance))
