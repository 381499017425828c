"""How the filter fared, in numbers: effective samples, fallbacks, doubts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.io.files.put_aside.spool import Spool
from occlog.records.tables import Diagnostics, Tracks

MARKS = 300
"""Fallbacks of a kind that are drawn."""


def has_particles(diagnostics: Diagnostics) -> bool:
    """Whether the diagnostics are of a particle filter."""
    return bool(np.isfinite(diagnostics.ess).any())


def deviation(tracks: Tracks) -> Floats:
    """(T,) standard deviation of the position: square root of the covariance's trace."""
    return np.sqrt(tracks.cov_xx + tracks.cov_yy)


@dataclass(frozen=True, eq=False)
class Fallbacks:
    """Fallbacks of one kind.

    Attributes:
        rows: how many there are.
        t_ns: (M,) times of those that are drawn: where there are very many, every k-th.
    """

    rows: int
    t_ns: Ints


@dataclass(frozen=True, eq=False)
class Fared:
    """What all diagnostics tell together.

    Attributes:
        rows: how many there are.
        particles: whether they are of a particle filter.
        lowest: effective sample size.
        fallbacks: by their kind, which rise.
        doubtful: rows with a doubt.
        doubts: kinds of doubts, which rise.
    """

    rows: int
    particles: bool
    lowest: float
    fallbacks: Mapping[str, Fallbacks]
    doubtful: int
    doubts: tuple[str, ...]


class FaredStreams:
    """Gathers how the filter fared while diagnostics stream by."""

    def __init__(self, in_memory: int = 1 << 16) -> None:
        """Nothing yet; of each kind so many times of fallbacks are kept `in_memory`."""
        self._in_memory = in_memory
        self._rows = self._doubtful = 0
        self._particles, self._lowest = False, np.inf
        self._start: int | None = None
        self._fallbacks: dict[str, Spool] = {}
        self._doubts: set[str] = set()

    def add(self, part: Diagnostics) -> None:
        """Some more."""
        if not len(part):
            return
        self._start = int(part.t_ns[0]) if self._start is None else self._start
        self._rows += len(part)
        self._particles = self._particles or has_particles(part)
        self._lowest = float(np.minimum(self._lowest, part.ess.min()))
        for kind in np.unique(part.fallback).tolist():
            if kind:
                # Times since the start, which a float carries to the nanosecond
                since = part.t_ns[part.fallback == kind] - self._start
                self._fallbacks.setdefault(kind, Spool(self._in_memory)).add(since.astype(np.float64))
        self._doubtful += int(np.count_nonzero(part.doubt != ""))
        self._doubts.update(kind for text in np.unique(part.doubt).tolist() if text for kind in text.split(","))

    def finish(self) -> Fared:
        """All that was gathered."""
        fallbacks = {kind: self._drawn(times) for kind, times in sorted(self._fallbacks.items())}
        doubts = tuple(sorted(self._doubts))
        return Fared(self._rows, self._particles, self._lowest, fallbacks, self._doubtful, doubts)

    def _drawn(self, times: Spool) -> Fallbacks:
        every, count, parts = -(-times.count // MARKS), 0, list[Ints]()
        for block in times.blocks():
            parts.append(block[-count % every :: every].astype(np.int64) + (self._start or 0))
            count += len(block)
        return Fallbacks(count, np.concatenate(parts))
