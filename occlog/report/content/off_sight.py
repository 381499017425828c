"""How far tracks are from sight lines, and from where these meet, gathered while both stream by."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.metrics.sums import Sum
from occlog.evaluate.errors.sums import quantiles_of
from occlog.io.files.put_aside.spool import IN_MEMORY, Spool
from occlog.records.scene import Scene
from occlog.records.tables import UNLABELLED, Bearings, Tracks

from .plane_of_sight import (
    Residuals,
    SightLines,
    label_of,
    meet,
    off_lines,
    places,
    positions_at,
    scans,
    sight_lines,
)
from .thinned import largest


@dataclass(frozen=True, eq=False)
class Residual:
    """What a track leaves of the directions that its target was seen in.

    Attributes:
        drawn: sightings, or a part of them.
        rows: of each sensor the number of all sightings.
        squares: (2,) of each sensor sums of all squared residuals, as angles [rad2] and in standard deviations.
        every: of each sensor each so manieth sighting is drawn.
    """

    drawn: Residuals
    rows: Mapping[str, int]
    squares: Mapping[str, Floats]
    every: int = 1

    @property
    def any(self) -> bool:
        """Whether there is any sighting."""
        return any(self.rows.values())


def _squares(residual: Floats, sigma: Floats) -> Floats:
    return np.asarray((np.column_stack([residual, residual / sigma]) ** 2).sum(axis=0))


@dataclass(frozen=True, eq=False)
class Distances:
    """Distances of a track from where the sight lines of scans meet.

    Attributes:
        t_ns: (D,) times of those that are drawn.
        distance: (D,) these.
        so_far: (D,) root mean square of all distances up to each.
        rows: how many there are in all.
        rms: root mean square of all of them; NaN without any.
        high: 95 % of all of them are below; NaN without any.
        every: each so manieth is drawn.
    """

    t_ns: Ints
    distance: Floats
    so_far: Floats
    rows: int
    rms: float
    high: float
    every: int = 1


@dataclass
class _Off:
    """What one target's track left up to now."""

    rows: Ints
    squares: Floats
    drawn: list[Residuals] = field(default_factory=list)
    held: tuple[SightLines, Floats] | None = None  # lines of a scan that may not be over, and estimates at them
    start_ns: int | None = None
    scans: int = 0
    total: Sum = field(default_factory=Sum)
    t_ns: list[Ints] = field(default_factory=list)
    distance: list[Floats] = field(default_factory=list)
    so_far: list[Floats] = field(default_factory=list)


class OffSightStreams:
    """Gathers residuals and distances while tracks and bearings stream by."""

    def __init__(
        self,
        scene: Scene,
        targets: Iterable[int],
        labels: Collection[int],
        periods_ns: Mapping[int, int | None],
        every: int = 1,
        in_memory: int = IN_MEMORY,
    ) -> None:
        """Nothing yet.

        Args:
            scene: the sensors.
            targets: that are tracked.
            labels: of all bearings.
            periods_ns: of targets whose distances are wanted the period of a scan; None: sensors share their times.
            every: of residuals of a sensor, and of distances, each so manieth is drawn, and the largest ones between.
            in_memory: how many distances are kept in memory.
        """
        self._scene, self._every, self._periods_ns = scene, every, periods_ns
        self._labels = {target: label_of(target, labels) for target in targets}
        count = len(places(scene))
        self._off = {target: _Off(np.zeros(count, np.int64), np.zeros((count, 2))) for target in self._labels}
        self._spools = {target: Spool(in_memory // len(periods_ns)) for target in periods_ns}

    def add(self, tracks: Tracks, bearings: Bearings) -> None:
        """The bearings of another stretch of time, and all estimates between which they are."""
        lines = sight_lines(bearings, self._scene, set(self._labels.values()))
        for target, label in self._labels.items():
            own, mine = self._off[target], lines[label]
            estimate = positions_at(tracks, target, mine.t_ns)
            self._residuals(own, off_lines(mine, estimate, self._scene, nearest=label == UNLABELLED))
            if target in self._periods_ns and label == target:
                self._distances(target, mine, estimate, last=False)

    def _residuals(self, own: _Off, found: Residuals) -> None:
        number = np.zeros(len(found.sensor), dtype=np.int64)
        for i in np.unique(found.sensor).tolist():
            mine = found.sensor == i
            number[mine] = own.rows[i] + np.arange(np.count_nonzero(mine))
            own.rows[i] += int(np.count_nonzero(mine))
            own.squares[i] += _squares(found.residual[mine], found.sigma[mine])
        keep = number % self._every == 0
        keep |= largest(np.abs(found.residual), found.sensor, number // self._every)
        parts = (each[keep] for each in (found.t_ns, found.sensor, found.residual, found.sigma))
        t_ns, sensor, residual, sigma = parts
        own.drawn.append(Residuals(t_ns, sensor, found.names, residual, sigma))

    def _distances(self, target: int, lines: SightLines, estimate: Floats, *, last: bool) -> None:
        """Distances at the scans that are over."""
        own, period = self._off[target], self._periods_ns[target]
        if own.held is not None:
            lines, estimate = _joined(own.held[0], lines), np.concatenate([own.held[1], estimate])
        if not len(lines.t_ns):
            return
        own.start_ns = int(lines.t_ns[0]) if own.start_ns is None else own.start_ns
        over = len(lines.t_ns)
        if period is not None and not last:
            scan = (lines.t_ns - own.start_ns) // period
            over = int(np.searchsorted(scan, scan[-1]))
        own.held = _part(lines, slice(over, None)), estimate[over:]
        rows, scan = scans(_part(lines, slice(0, over)), period, own.start_ns)
        first, xy = meet(lines, rows, scan, self._scene)
        found = np.hypot(*(estimate[first] - xy).T)
        told = np.isfinite(found)
        t_ns, found = lines.t_ns[first][told], found[told]
        number = own.scans + np.arange(len(found))
        so_far = np.sqrt((own.total.value + np.cumsum(found**2)) / (number + 1))
        keep = (number % self._every == 0) | largest(found, np.zeros(len(found), np.int64), number // self._every)
        own.t_ns.append(t_ns[keep])
        own.distance.append(found[keep])
        own.so_far.append(so_far[keep])
        own.total.add(float(np.sum(found**2)))
        own.scans += len(found)
        self._spools[target].add(found)

    def finish(self) -> tuple[dict[int, Residual], dict[int, Distances]]:
        """Everything, by target."""
        names = tuple(places(self._scene))
        off, apart = {}, {}
        for target, own in self._off.items():
            empty = (np.zeros(0, np.int64), np.zeros(0, np.int64), names, np.zeros(0), np.zeros(0))
            parts = [Residuals(*empty), *own.drawn]
            columns = {
                c: np.concatenate([getattr(p, c) for p in parts]) for c in ("t_ns", "sensor", "residual", "sigma")
            }
            rows = {name: int(count) for name, count in zip(names, own.rows, strict=True)}
            squares = dict(zip(names, own.squares, strict=True))
            off[target] = Residual(Residuals(names=names, **columns), rows, squares, self._every)
            if target in self._periods_ns:
                if own.held is not None:
                    nothing = _part(own.held[0], slice(0, 0))
                    self._distances(target, nothing, np.zeros((0, 2)), last=True)
                apart[target] = self._apart(own, self._spools[target])
        return off, apart

    def _apart(self, own: _Off, spool: Spool) -> Distances:
        count = own.scans
        (high,) = quantiles_of(spool, [0.95])
        return Distances(
            np.concatenate([np.zeros(0, np.int64), *own.t_ns]),
            np.concatenate([np.zeros(0), *own.distance]),
            np.concatenate([np.zeros(0), *own.so_far]),
            count,
            float(np.sqrt(own.total.value / count)) if count else float("nan"),
            high,
            self._every,
        )


def _part(lines: SightLines, rows: slice) -> SightLines:
    return SightLines(lines.t_ns[rows], lines.sensor[rows], lines.bearing[rows], lines.sigma[rows])


def _joined(a: SightLines, b: SightLines) -> SightLines:
    columns = ("t_ns", "sensor", "bearing", "sigma")
    return SightLines(*(np.concatenate([getattr(a, c), getattr(b, c)]) for c in columns))
