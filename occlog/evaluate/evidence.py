"""What bearings say for and against tracks."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from occlog.array_types import NS
from occlog.consistency.agreement import pose_share
from occlog.consistency.alone import TOGETHER_S, near_another
from occlog.consistency.sight import Sight
from occlog.consistency.verdict import Evidence
from occlog.errors import InputError
from occlog.evaluate.errors.sums import median_of
from occlog.evaluate.verdict import Made, used
from occlog.io.files.put_aside.spool import IN_MEMORY, Spool
from occlog.records.pieces import LAST, Limits, Side
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Diagnostics, Residuals, Tracks


class SightEvidence:
    """What bearings say for and against tracks."""

    def __init__(
        self, evidence: Evidence, scene: Scene, made: Made, held_out: tuple[str, ...], in_memory: int = IN_MEMORY
    ) -> None:
        """Nothing was seen yet.

        Args:
            evidence: takes what is found.
            scene: the sensors.
            made: how the tracks were made.
            held_out: sensors that the tracks were made without.
            in_memory: how many distances of all cameras are kept in memory.
        """
        self._evidence, self._scene, self._made, self._held_out = evidence, scene, made, held_out
        self._of_estimates, self._of_frames = (Sight(scene, made.window_ns) for _ in range(2))
        self._alone = _Alone(evidence)
        unsure = [c for c in scene.cameras if c.sigma_yaw > 0.0 or c.sigma_position > 0.0]
        self._distances = {c.name: Spool(in_memory // len(unsure)) for c in unsure}

    @property
    def margin_ns(self) -> int:
        """How far about a stretch tracks and bearings must be there."""
        return self._made.window_ns + 1

    def update(
        self, limits: Limits, tracks: Side[Tracks], bearings: Side[Bearings], diagnostics: Side[Diagnostics] | None
    ) -> None:
        """Another stretch; `diagnostics` are of the same rows as the tracks (`in_rows_of`)."""
        window_ns, before = self._made.window_ns, Limits(limits.begin, limits.end)
        ours, its = before.about(tracks, window_ns, 0), before.about(bearings, window_ns, 0)
        fared = None if diagnostics is None else before.about(diagnostics, window_ns, 0)
        its = used(its, self._made, self._held_out)
        residuals, frames = self._of_estimates.compare(ours, its, fared)
        if window_ns:
            # A bearing may belong to an estimate after the stretch
            ours, its = before.about(tracks, 0, self.margin_ns), used(before.of(bearings), self._made, self._held_out)
            fared = None if diagnostics is None else before.about(diagnostics, 0, self.margin_ns)
            _, frames = self._of_frames.compare(ours, its, fared)
            ours = before.about(tracks, window_ns, 0)
        residuals = residuals.take(residuals.t_ns >= limits.begin)
        evidence, own = self._evidence, limits.of(tracks)
        for camera in self._scene.cameras:
            if camera.name in self._distances:
                x, y = own.x - camera.position[0], own.y - camera.position[1]
                self._distances[camera.name].add(np.hypot(x, y))
        evidence.agreements.add(residuals)
        evidence.crowd.add(frames)
        evidence.places.add(ours, residuals, self._scene)
        self._alone.add(residuals, limits.end)

    def finish(self) -> None:
        """Say that all stretches came."""
        self._alone.add(Residuals.empty(), LAST)
        for camera in self._scene.cameras:
            found = self._evidence.agreements.sensors.get(camera.name)
            if found is not None and camera.name in self._distances and self._distances[camera.name].count:
                found.pose = pose_share(camera, median_of(self._distances[camera.name])) * found.means.expected


class _Alone:
    """Counts bearings near to one of another sensor, once all about them have come."""

    def __init__(self, evidence: Evidence) -> None:
        self._evidence = evidence
        self._kept, self._begin = Residuals.empty(), 0
        self._first: dict[int, int] = {}

    def add(self, residuals: Residuals, end_ns: int) -> None:
        """Some more rows; none that comes later is before `end_ns`."""
        rows = Residuals.concat([self._kept, residuals])
        if not len(rows):
            return
        near_ns = round(TOGETHER_S * NS) + 1
        ready = len(rows) if end_ns == LAST else int(np.searchsorted(rows.t_ns, end_ns - near_ns))
        done, alone = np.arange(len(rows)) < self._begin, self._evidence.alone
        for target in np.unique(rows.target_id).tolist():
            mine = rows.target_id == target
            own = rows.take(mine)
            # Seconds since the first bearing of all, so that chunks change no rounding
            seconds = (own.t_ns - self._first.setdefault(target, int(own.t_ns[0]))) / NS
            new = ~done[mine] & (np.flatnonzero(mine) < ready)
            alone.bearings += int(np.count_nonzero(new))
            alone.confirmed += int(np.count_nonzero(near_another(own.sensor, seconds)[new]))
            alone.doubted += int(np.count_nonzero(own.believed[new] < 0.5))
        since = 0 if ready == 0 else int(np.searchsorted(rows.t_ns, rows.t_ns[ready - 1] - near_ns))
        self._kept, self._begin = rows.take(slice(since, None)), max(ready, self._begin) - since


def in_rows_of(tracks: Iterable[Tracks], diagnostics: Iterable[Diagnostics]) -> Iterator[Diagnostics]:
    """Diagnostics of the rows of tracks, one for each, at the times of these.

    Raises:
        InputError: there are fewer or more of them.
    """
    held, rest = Diagnostics.empty(), iter(diagnostics)
    for chunk in tracks:
        while len(held) < len(chunk):
            more = next(rest, None)
            if more is None:
                raise InputError("diagnostics: fewer rows than the tracks have")
            held = Diagnostics.concat([held, more])
        yield replace(held.take(slice(0, len(chunk))), t_ns=chunk.t_ns)
        held = held.take(slice(len(chunk), None))
