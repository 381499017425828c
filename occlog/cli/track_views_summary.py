"""What `occlog track` says of tracks in images when it is done."""

from __future__ import annotations

from collections import Counter
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from ..losses import Loss
from ..stages.detect_camera import stretches

if TYPE_CHECKING:
    from ..stages.track_views import ViewsPart
    from ..stages.view_checks import Checks
    from .track_views_input import ViewsInput

FEWEST_CHECKS = 20
"""Loop checks below which nothing is said about a fundamental matrix."""
BIN_PX, BINS = 0.1, 20_001
"""Of the histogram of distances; the last bin holds all that are farther."""
EARLY_PERIODS = 3
"""A view ends early when others go on for more of its frame periods than this."""
ALONE = {"bmct": "does what idmot does", "cmct": "does what mipf does, with colours that adapt"}
"""What methods do without another view's help; the others never have any."""


class ViewsTally:
    """Figures of the summary, gathered while streaming."""

    def __init__(self, method: str, inputs: ViewsInput) -> None:
        """Nothing yet."""
        self.method, self.inputs = method, inputs
        n = len(inputs.views)
        self.rows = 0
        self.targets: set[int] = set()
        self.frames = np.zeros(n, dtype=np.int64)
        self.last_ns = np.full(n, -1, dtype=np.int64)
        self.events: Counter[str] = Counter()
        self.begun: set[str] = set()
        self.modes: Counter[str] = Counter()
        self.lost: list[list[tuple[int, str]]] = [[] for _ in range(n)]
        self.failed = np.zeros((n, n), dtype=np.int64)
        self.distances = {pair: np.zeros(BINS, dtype=np.int64) for pair in combinations(range(n), 2)}
        self.dropped: list[tuple[int, int]] = []
        self.places: Counter[str] = Counter()

    def add(self, part: ViewsPart) -> None:
        """Count some more moments."""
        self.rows += len(part.tracks)
        self.targets.update(part.tracks.target_id.tolist())
        self.frames += part.frames
        self.last_ns = np.maximum(self.last_ns, part.last_ns)
        self.events.update(e for e in part.tracks.event.tolist() if e)
        self.begun.update(part.tracks.sensor[part.tracks.event == "start"].tolist())
        self.modes.update(m for m in part.tracks.mode.tolist() if m)
        for view, frame, why in part.lost:
            self.lost[view].append((frame, why))
        self._check(part.checks)
        self._check(part.start_checks)
        self.dropped += part.dropped

    def _check(self, checks: Checks) -> None:
        for a, b, radii, px in zip(*(column.tolist() for column in checks), strict=True):
            self.failed[int(a), int(b)] += radii > 1.0
            self.distances[int(a), int(b)][int(min(px / BIN_PX, BINS - 1))] += 1

    def losses(self) -> list[Loss]:
        """Frames that could not be used, in stretches."""
        return [
            loss for view, lost in zip(self.inputs.views, self.lost, strict=True) for loss in stretches(view.name, lost)
        ]

    def summary(self) -> dict[str, Any]:
        """The figures."""
        names = self.inputs.names
        total = max(sum(self.modes.values()), 1)
        checks = {
            f"{names[a]}-{names[b]}": {"checks": int(n), "failed": int(self.failed[a, b])}
            for (a, b), distances in self.distances.items()
            if (n := distances.sum())
        }
        return {
            "targets": len(self.targets),
            "rows": self.rows,
            "frames": dict(zip(names, self.frames.tolist(), strict=True)),
            "started": self.events["start"],
            "left": self.events["left"],
            "lost_trackers": self.events["lost"],
            "modes": {mode: n / total for mode, n in sorted(self.modes.items())},
            "loop_checks": checks,
            **({"places": dict(sorted(self.places.items()))} if self.places else {}),
        }

    def warnings(self) -> list[str]:
        """What whoever uses the tracks should know."""
        lines = [*self._alone(), *self._ends(), *(self._misfit(a, b) for a, b in self._misfits())]
        if (late := self.inputs.given - self.events["start"]) > 0:
            lines.append(f"{late} of {self.inputs.given} first ellipses began no tracker: the video ends before them")
        bare = [name for name in self.inputs.names if name not in self.begun]
        if self.begun and bare and self.inputs.request.births == "initial":
            lines.append(
                f"no first ellipse began a tracker in {', '.join(bare)}: nothing is tracked there, and no other view "
                f"is helped from there; give some, or leave out what is not wanted (--without {','.join(bare)})"
            )
        if not self.rows:
            lines.append("no target was found; give the first ellipses (--initial) or better --detections")
        return lines

    def _alone(self) -> list[str]:
        if self.method not in ALONE:
            return []
        does = f"--method {self.method} {ALONE[self.method]}"
        if len(self.inputs.views) == 1:
            return [f"there is one view, {self.inputs.names[0]}, and none to help it: {does}"]
        if not np.isfinite(self.inputs.geometry.fundamental).any():
            return [
                f"nothing tells how the views see the same point, so none helps another: {does}; give fundamental "
                "matrices (--fundamental), or a scene with the cameras' poses"
            ]
        return []

    def _ends(self) -> list[str]:
        """Views that end before the others."""
        latest = int(self.last_ns.max(initial=-1))
        lines = []
        for s, last, n in zip(self.inputs.surveyed, self.last_ns.tolist(), self.frames.tolist(), strict=True):
            if last >= 0 and latest - last > EARLY_PERIODS * max(s.period_ns, 2 * self.inputs.window_ns):
                lines.append(
                    f"view {s.view.name} ends {(latest - last) / 1e9:.3g} s before the others, after {n} frames"
                )
        return lines

    def _misfits(self) -> list[tuple[int, int]]:
        """Pairs of views that most loop checks contradict."""
        most = [
            pair
            for pair, distances in self.distances.items()
            if (n := int(distances.sum())) >= FEWEST_CHECKS and 2 * int(self.failed[pair]) > n
        ]
        return sorted({*most, *self.dropped})

    def _misfit(self, a: int, b: int) -> str:
        distances = self.distances[a, b]
        n = int(distances.sum())
        median = BIN_PX * (int(np.searchsorted(np.cumsum(distances), 0.5 * n)) + 0.5)
        names = self.inputs.names
        unused = "; trackers did without it" if (a, b) in self.dropped else ""
        return (
            f"views {names[a]} and {names[b]}: the fundamental matrix does not fit: {self.failed[a, b] / n:.0%} of "
            f"{n} loop checks fail, median distance {median:.0f} px{unused}; give another (--fundamental), or leave "
            "one view out (--without)"
        )
