"""Plausibility of the speeds of people, which wrong times or frame rates contradict."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from occlog.array_types import NS, Floats
from occlog.records.columns import rows_by_label
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
TOP, TOP_RATIO = 0.9, 1.6
"""Quantile of the speeds that is compared, too, where others stand; ratio of its limit to that of the median."""
MIN_TOP_SPEED = 0.15
"""Speed [heights/s] that each person who covers a leg reaches at times, even in a queue: 0.26 m/s."""
LEG, MIN_LEGS, SLOW_SHARE = 0.3, 10, 0.5
"""Distance [heights] of a leg of a track, number of slow ones, and their share of all, for people who are too slow."""
MIN_ROWS, MIN_SHARE = 50, 0.1
"""Rows of people who move, and their share of all rows."""
BINS_PER_HEIGHT, MAX_BINS = 20, 4000
"""Bins of the histogram of speeds for 1 height/s; faster rows are in the last one."""


class PeopleSpeeds:
    """Speeds, durations and legs of tracks over a stream of tables, and a check that they are those of people.

    A leg is a stretch of a track that ends `LEG` heights of a person away from its start.
    """

    def __init__(self, person_height: float) -> None:
        """Start without tracks; `person_height` is the mean height of people in the scene's unit."""
        self.height = person_height
        self.rows = 0
        self._bins = np.zeros(MAX_BINS, dtype=np.int64)
        # Of each track: first and last time [s]; x and y where its leg began, and the top speed since
        self._tracks: dict[int, tuple[float, float]] = {}
        self._legs: dict[int, tuple[Floats, float]] = {}
        self.legs = self.slow_legs = 0

    def add(self, tracks: PeopleTracks) -> None:
        """Add the rows of a table of tracks, which must be in the order of time over all calls."""
        if not len(tracks):
            return
        speed = np.hypot(tracks.vx, tracks.vy) / self.height
        bins = np.minimum(speed * BINS_PER_HEIGHT, MAX_BINS - 1).astype(np.int64)
        self._bins += np.bincount(bins, minlength=MAX_BINS)
        self.rows += len(tracks)
        places = np.column_stack([tracks.x, tracks.y])
        for id, rows in rows_by_label(tracks.target_id):
            first, last = (float(tracks.t_ns[k]) / NS for k in (rows[0], rows[-1]))
            self._tracks[id] = (self._tracks.get(id, (first, last))[0], last)
            self._add_legs(id, places[rows], speed[rows])

    def _add_legs(self, id: int, places: Floats, speed: Floats) -> None:
        """Count the completed legs of the track `id`, and the slow ones among them.

        `places` (n, 2) are its next positions, `speed` (n,) [person heights/s]; the last leg stays open. A leg is slow
        if its top speed is below `MIN_TOP_SPEED`.
        """
        begin, top = self._legs.get(id, (places[0], 0.0))
        while len(places):
            beyond = np.flatnonzero(np.hypot(*(places - begin).T) >= LEG * self.height)
            end = int(beyond[0]) + 1 if len(beyond) else len(places)
            top = max(top, float(speed[:end].max()))
            if len(beyond):
                self.legs += 1
                self.slow_legs += top < MIN_TOP_SPEED
                begin, top = places[end - 1], 0.0
            places, speed = places[end:], speed[end:]
        self._legs[id] = (begin, top)

    @property
    def median(self) -> float:
        """Median speed [scene unit/s] of the rows of people who move; NaN where too few do."""
        return self._quantile(0.5)

    def _quantile(self, share: float) -> float:
        """Return the quantile `share` of the speeds [scene unit/s] of people who move; NaN where too few do."""
        moving = self._bins[round(MOVING * BINS_PER_HEIGHT) :]
        count = int(moving.sum())
        if count < max(MIN_ROWS, MIN_SHARE * self.rows):
            return float("nan")
        found = int(np.searchsorted(np.cumsum(moving), share * count))
        return (MOVING + (found + 0.5) / BINS_PER_HEIGHT) * self.height

    def checks(self, unit: str) -> tuple[Check, ...]:
        """Return the check of the speeds of people, with its findings; `unit` is the length unit, for messages."""
        few = "" if np.isfinite(self.median) or self.slow_legs >= MIN_LEGS else "too few people move"
        return outcome(SPEEDS, self._findings(unit), unless=few, median=self.median)

    def _findings(self, unit: str) -> Iterator[Check]:
        """Generate a finding if people are faster than runners, or too slow for the distance that they cover.

        `unit` is the length unit, for messages.
        """
        ends = np.array(list(self._tracks.values())).reshape(-1, 2)
        life_s = float((ends[:, 1] - ends[:, 0]).mean()) if len(ends) else 0.0
        limit = (MAX_SPEED if life_s >= SHORT_S else MAX_SPEED_IF_SHORT) * self.height
        speeds = {"median": (self.median, limit), "upper tenth": (self._quantile(TOP), TOP_RATIO * limit)}
        for which, (speed, allowed) in speeds.items():
            if speed > allowed:
                births_per_s = len(ends) / max(float(ends[:, 1].max() - ends[:, 0].min()), 1e-9)
                yield finding(
                    SPEEDS, "speeds-high", speed=speed, which=which, unit=unit, allowed=allowed, life_s=life_s,
                    births_per_s=births_per_s,
                )  # fmt: skip
                return
        if self.slow_legs >= MIN_LEGS and self.slow_legs > SLOW_SHARE * self.legs:
            yield finding(SPEEDS, "speeds-low", count=self.slow_legs, of=self.legs, unit=unit,
                leg=LEG * self.height, allowed=MIN_TOP_SPEED * self.height)  # fmt: skip
