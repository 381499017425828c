"""Plausibility of the speeds of people, which wrong times or frame rates contradict."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from occlog.array_types import NS, Floats
from occlog.records.tables import PeopleTracks
from occlog.records.verdicts import Check, finding, outcome

SPEEDS = "speeds of people"
"""Name of the check."""
MOVING = 0.2
"""Speed [heights of people per second] from which a person moves: 0.34 m/s."""
MAX_SPEED, MAX_SPEED_IF_SHORT = 3.0, 1.8
"""Median speed of those who move [heights/s] that only sprinters exceed (5.1 m/s), and the one that runners exceed, too
(3.1 m/s), of which tracks are no shorter than `SHORT_S`."""
SHORT_S = 1.0
"""Mean duration of tracks [s] below which fast people are not tracked but mistaken for each other."""
MIN_TOP_SPEED = 0.15
"""Speed [heights/s] that each person who covers a distance reaches at times, even in a queue: 0.26 m/s."""
MIN_DISTANCE, MIN_TRACKS = 1.5, 2
"""Extent [heights] of a track that covers a distance, and number of such tracks for a check of slowness."""
MIN_ROWS, MIN_SHARE, TOP_SHARE = 50, 0.1, 0.05
"""Rows of people who move, their share of all rows, and share of the rows of a track at its top speed."""
BINS_PER_HEIGHT, MAX_BINS = 20, 4000
"""Bins of the histogram of speeds for 1 height/s; faster rows are in the last one."""


class PeopleSpeeds:
    """Speed, extent and duration of each track, over a stream of tables."""

    def __init__(self, person_height: float) -> None:
        """Start without tracks; `person_height` in the scene's unit."""
        self.height = person_height
        self.rows = 0
        self._bins = np.zeros(MAX_BINS, dtype=np.int64)
        # Of each track: largest of -t [s], t, -x, x, -y, y; number of rows, and of those at its top speed
        self._tracks: dict[int, Floats] = {}

    def add(self, tracks: PeopleTracks) -> None:
        """Add rows of tracks to the speeds, extents and durations."""
        if not len(tracks):
            return
        speed = np.hypot(tracks.vx, tracks.vy) / self.height
        bins = np.minimum(speed * BINS_PER_HEIGHT, MAX_BINS - 1).astype(np.int64)
        self._bins += np.bincount(bins, minlength=MAX_BINS)
        self.rows += len(tracks)
        order = np.argsort(tracks.target_id, kind="stable")
        ids, first = np.unique(tracks.target_id[order], return_index=True)
        t_s = tracks.t_ns / NS
        ends = np.column_stack([-t_s, t_s, -tracks.x, tracks.x, -tracks.y, tracks.y])[order]
        counts = np.column_stack([np.ones(len(tracks)), speed >= MIN_TOP_SPEED])[order]
        for id, most, count in zip(
            ids.tolist(), np.maximum.reduceat(ends, first), np.add.reduceat(counts, first), strict=True
        ):
            known = self._tracks.get(id)
            self._tracks[id] = (
                np.append(most, count) if known is None else np.append(np.maximum(known[:6], most), known[6:] + count)
            )

    @property
    def median(self) -> float:
        """Median speed [scene's unit/s] of the people who move; NaN where too few do."""
        moving = self._bins[round(MOVING * BINS_PER_HEIGHT) :]
        count = int(moving.sum())
        if count < max(MIN_ROWS, MIN_SHARE * self.rows):
            return float("nan")
        middle = int(np.searchsorted(np.cumsum(moving), count / 2))
        return (MOVING + (middle + 0.5) / BINS_PER_HEIGHT) * self.height

    def checks(self, unit: str) -> tuple[Check, ...]:
        """The check of speeds; `unit` of lengths."""
        few = "" if np.isfinite(self.median) or len(self._slow()) >= MIN_TRACKS else "too few people move"
        return outcome(SPEEDS, self._findings(unit), unless=few, median=self.median)

    def _findings(self, unit: str) -> Iterator[Check]:
        """Generate findings about people who are faster than any runner, or too slow for the distance they cover."""
        tracks = np.array(list(self._tracks.values())).reshape(-1, 8)
        life_s = float((tracks[:, 0] + tracks[:, 1]).mean()) if len(tracks) else 0.0
        limit = (MAX_SPEED if life_s >= SHORT_S else MAX_SPEED_IF_SHORT) * self.height
        if self.median > limit:
            yield finding(
                SPEEDS, "speeds-high", speed=self.median, unit=unit, allowed=limit, life_s=life_s,
                births_per_s=len(tracks) / max(float(tracks[:, 1].max() + tracks[:, 0].max()), 1e-9),
            )  # fmt: skip
        slow = self._slow()
        if len(slow) >= MIN_TRACKS and np.count_nonzero(slow) > 0.5 * len(slow):
            yield finding(SPEEDS, "speeds-low", count=int(np.count_nonzero(slow)), of=len(slow),
                unit=unit, allowed=MIN_TOP_SPEED * self.height)  # fmt: skip

    def _slow(self) -> Floats:
        """(n,) 1 for each track that covers a distance and never reaches walking speed, else 0."""
        tracks = np.array(list(self._tracks.values())).reshape(-1, 8)
        extent = np.hypot(tracks[:, 2] + tracks[:, 3], tracks[:, 4] + tracks[:, 5])
        far = tracks[extent >= MIN_DISTANCE * self.height]
        return np.asarray(far[:, 7] < TOP_SHARE * far[:, 6], dtype=np.float64)
