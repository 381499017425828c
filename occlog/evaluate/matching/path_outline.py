"""Paths of true objects around a time interval, with coarse samples of the whole (`TruthOutlines`).

Interpolation uses samples nearby. An approximate position over a wide gap, or before the first and after the last
sample, needs samples that may be far away, which are kept.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from occlog.array_types import NS, Floats, Ints
from occlog.evaluate.errors.survey import TruthIntervals
from occlog.records.tables import Truth

from .paths import ObjectPath

NEAR_NS = 60 * NS
"""Samples further apart than this are kept of the whole; samples are needed this far around a section."""
TARGET, OCCLUDER = "target", "occluder"


@dataclass
class _Outline:
    """Coarse samples of one object's path: both sides of every gap above `NEAR_NS`, the first sample and the last one.

    `t_ns` and `xyz` are lists of times (n,) [ns] and positions (n, 3).
    """

    t_ns: list[Ints] = field(default_factory=list)
    xyz: list[Floats] = field(default_factory=list)
    last: tuple[int, Floats] | None = None  # the last sample so far
    last_high: tuple[int, Floats] | None = None  # the last one with a height

    def add(self, t_ns: Ints, xyz: Floats) -> None:
        high = np.isfinite(xyz[:, 2])
        self.last = self._edges(t_ns, xyz, self.last)
        self.last_high = self._edges(t_ns[high], xyz[high], self.last_high)

    def _edges(self, t_ns: Ints, xyz: Floats, last: tuple[int, Floats] | None) -> tuple[int, Floats] | None:
        """Keep the samples on both sides of wide gaps, and the very first one; return the last sample so far.

        Args:
            t_ns: (n,) times of the next samples [ns].
            xyz: (n, 3) positions.
            last: time and position (1, 3) of the last sample before; None: these are the first.
        """
        if not len(t_ns):
            return last
        if last is not None:
            t_ns, xyz = np.insert(t_ns, 0, last[0]), np.vstack([last[1], xyz])
        wide = np.diff(t_ns) > NEAR_NS
        keep = np.append(False, wide) | np.append(wide, False)
        keep[0] |= last is None
        self.t_ns.append(t_ns[keep])
        self.xyz.append(xyz[keep])
        return int(t_ns[-1]), xyz[-1:]

    def whole(self) -> tuple[Ints, Floats]:
        """Return times (K,) [ns] of the kept samples, nondecreasing, and positions (K, 3)."""
        ends = [each for each in (self.last_high, self.last) if each is not None]
        t_ns = np.concatenate([*self.t_ns, np.array([t for t, _ in ends], dtype=np.int64)])
        xyz = np.concatenate([*self.xyz, *(position for _, position in ends)])
        order = np.argsort(t_ns, kind="stable")
        return t_ns[order], xyz[order]


class TruthOutlines:
    """Collects coarse samples of the paths of all true objects (targets and moving occluders) from a stream of chunks.

    They give approximate positions over wide gaps and beyond the ends of a path.
    """

    def __init__(self) -> None:
        """Create outlines without objects."""
        self._found: dict[tuple[str, int], _Outline] = {}
        self._steps = TruthIntervals()
        self.high: set[int] = set()
        """Targets with known height somewhere."""
        self._kept: dict[tuple[str, int], tuple[Ints, Floats]] | None = None
        self._gaps_ns: dict[int, int] = {}

    def watch(self, chunks: Iterable[Truth]) -> Iterator[Truth]:
        """Generate the chunks unchanged, and collect coarse samples from them on the way."""
        for chunk in chunks:
            self._add(chunk)
            yield chunk

    def _add(self, rows: Truth) -> None:
        xyz = np.column_stack([rows.x, rows.y, rows.z])
        for role in (TARGET, OCCLUDER):
            own = np.flatnonzero(rows.role == role)
            for label in np.unique(rows.target_id[own]).tolist():
                mine = own[rows.target_id[own] == label]
                known = self._found.setdefault((role, label), _Outline())
                if role == OCCLUDER:
                    self._steps.add(label, rows.t_ns[mine], None if known.last is None else known.last[0])
                elif np.isfinite(rows.z[mine]).any():
                    self.high.add(label)
                known.add(rows.t_ns[mine], xyz[mine])

    def labels(self, role: str) -> list[int]:
        """Return the identities of the objects with a role (`target` or `occluder`), sorted."""
        return sorted(label for known, label in self._found if known == role)

    def gaps_ns(self, role: str, of_targets: dict[int, int]) -> dict[int, int]:
        """Return the default for the widest gap [ns] that is interpolated, by identity, for the objects of a role.

        `of_targets`: returned unchanged if the role is `target`.
        """
        if role == TARGET:
            return of_targets
        if not self._gaps_ns:
            self._gaps_ns = self._steps.usual_gaps_ns()
        return self._gaps_ns

    def paths(self, near: Truth, limits: tuple[int, int], role: str, gaps_ns: dict[int, int]) -> dict[int, ObjectPath]:
        """Return the path of each object of a role by identity: all samples nearby, and coarse samples far away.

        Args:
            near: all rows of the truth between both limits.
            limits: begin and end (excluded) [ns]; at least `NEAR_NS` and the widest interpolated gap around the times
                at which positions are needed.
            role: `target` or `occluder`.
            gaps_ns: widest gap that is interpolated [ns], by identity.
        """
        if self._kept is None:
            self._kept = {name: each.whole() for name, each in self._found.items()}
        own = np.flatnonzero(near.role == role)
        order = own[np.argsort(near.target_id[own], kind="stable")]
        names = near.target_id[order]
        xyz = np.column_stack([near.x, near.y, near.z])
        out = {}
        for label in self.labels(role):
            rows = order[np.searchsorted(names, label) : np.searchsorted(names, label, side="right")]
            t_ns, far = self._kept[role, label]
            before, after = t_ns < limits[0], t_ns >= limits[1]
            at = np.concatenate([t_ns[before], near.t_ns[rows], t_ns[after]])
            position = np.concatenate([far[before], xyz[rows], far[after]])
            out[label] = ObjectPath(at, position[:, :2], position[:, 2], gaps_ns[label])
        return out
