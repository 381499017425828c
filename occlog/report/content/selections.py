"""Which cameras were selected when: how often, for how long each, and the error that was expected of them and found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from occlog.array_types import Ints
from occlog.core.metrics.sums import Sum
from occlog.records.tables import Diagnostics, Errors, Tracks

Cameras = frozenset[str]


@dataclass(frozen=True, eq=False)
class Selections:
    """Selections of one target.

    Attributes:
        count: how many there are.
        times: (n + 1,) times of those that are drawn, and the last scan [ns].
        chosen: n, the cameras of each.
        shares: of the time from the first selection to the last scan for which each camera was selected.
        expected: RMS of the error expected at selections.
        found: RMS of what came out right then; NaN: nothing is known.
        what: `error`, `stated spread`, or nothing if that is not known.
    """

    count: int
    times: Ints
    chosen: tuple[Cameras, ...]
    shares: Mapping[str, float]
    expected: float
    found: float
    what: str


@dataclass
class _Target:
    count: int = 0
    expected: Sum = field(default_factory=Sum)
    first: int = 0
    since: tuple[int, Cameras] = (0, frozenset())  # the selection that holds
    last: int = 0
    selected_ns: dict[str, int] = field(default_factory=dict)
    times: list[int] = field(default_factory=list)
    chosen: list[Cameras] = field(default_factory=list)
    found: dict[str, tuple[int, Sum]] = field(default_factory=dict)

    def hold(self, until: int) -> None:
        """The selection up to now was for so long."""
        begin, cameras = self.since
        for name in cameras:
            self.selected_ns[name] = self.selected_ns.get(name, 0) + until - begin


class SelectionStreams:
    """Gathers selections while diagnostics stream by, and what came out while errors or tracks do beside them."""

    def __init__(self, every: int = 1) -> None:
        """Nothing was selected yet; each so manieth selection is drawn."""
        self._every = every
        self._targets: dict[int, _Target] = {}

    def add(self, part: Diagnostics) -> None:
        """Some more, in the order of time."""
        rows = np.isfinite(part.predicted_mse)
        for target in np.union1d(part.target_id[rows], np.array(list(self._targets), np.int64)).astype(int).tolist():
            mine = part.target_id == target
            if not mine.any():
                continue
            own = self._targets.setdefault(target, _Target())
            chosen = np.flatnonzero(mine & rows)
            for row in chosen.tolist():
                t_ns, cameras = int(part.t_ns[row]), frozenset(part.selected[row].split(","))
                own.hold(t_ns)
                own.first = own.first if own.count else t_ns
                own.since = t_ns, cameras
                if own.count % self._every == 0:
                    own.times.append(t_ns)
                    own.chosen.append(cameras)
                own.count += 1
            own.expected.add(float(part.predicted_mse[chosen].sum()))
            own.last = int(part.t_ns[mine][-1])

    def came_out(self, part: Diagnostics, beside: Errors | Tracks) -> None:
        """What errors or tracks say at the times of selections, both of a stretch of time."""
        told = np.isfinite(part.predicted_mse)
        for target in np.unique(part.target_id[told]).tolist():
            at = np.isin(beside.t_ns, part.t_ns[told & (part.target_id == target)])
            rows = at & (beside.target_id == target)
            if isinstance(beside, Errors):
                what, squares = "error", beside.error[rows] ** 2
            else:
                what, squares = "stated spread", beside.cov_xx[rows] + beside.cov_yy[rows]
            count, total = self._targets[target].found.setdefault(what, (0, Sum()))
            total.add(float(squares.sum()))
            self._targets[target].found[what] = count + len(squares), total

    @property
    def any(self) -> bool:
        """Whether cameras were selected for any target."""
        return bool(self._targets)

    def finish(self) -> dict[int, Selections]:
        """All that was gathered, by rising target."""
        return {target: _finished(own) for target, own in sorted(self._targets.items())}


def _finished(own: _Target) -> Selections:
    own.hold(own.last)
    whole = max(float(own.last - own.first), 1.0)
    what = next((what for what in ("error", "stated spread") if own.found.get(what, (0,))[0]), "")
    found = float("nan")
    if what:
        count, total = own.found[what]
        found = float(np.sqrt(total.value / count))
    return Selections(
        count=own.count,
        times=np.array([*own.times, own.last], dtype=np.int64),
        chosen=tuple(own.chosen),
        shares={name: spent / whole for name, spent in own.selected_ns.items()},
        expected=float(np.sqrt(own.expected.value / own.count)),
        found=found,
        what=what,
    )
