"""Clocks of a scene that differ from those by which an input's times were corrected: the difference is applied once.

The times of a recording are corrected by the clocks of the scene stored in it. A scene given to `track` may state
others, e.g. after a calibration. A camera without a clock there is unchanged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

from occlog.io.open import Opened
from occlog.records.scene import Camera, Clock, Scene

CLOCKS = "clocks"
"""Parameter of a table's provenance: clocks by which the times of its cameras were corrected, by camera."""
RIGHT = Clock("")


class ClockCorrection(NamedTuple):
    """Clock by which the times of a sensor were corrected, and the clock by which they should be."""

    before: Clock
    after: Clock

    def time(self, t_ns: int, first_ns: int) -> int:
        """Return the world time [ns] by the second clock, of a time `t_ns` [ns] that was corrected by the first clock.

        `first_ns`: first time of the sensor [ns], corrected by the first clock.
        """
        elapsed = (t_ns - first_ns) / (1.0 - self.before.drift_ppm * 1e-6)
        start = first_ns + self.before.offset_ns - self.after.offset_ns
        return start + round(elapsed * (1.0 - self.after.drift_ppm * 1e-6))

    @property
    def differs(self) -> bool:
        """Return whether the two clocks have different offsets or drifts."""
        return self.before.offset_ns != self.after.offset_ns or self.before.drift_ppm != self.after.drift_ppm


def clocks_of(scene: Scene) -> dict[str, Clock]:
    """Return the clocks of the scene's cameras, by camera name; cameras without a clock are missing."""
    named = {clock.name: clock for clock in scene.clocks}
    return {camera.name: named[camera.clock] for camera in scene.cameras if camera.clock is not None}


def applied_clocks(opened: Opened) -> dict[str, Clock] | None:
    """Return the clocks by which the times of an input were corrected, by camera name; None if unknown."""
    if opened.recording is not None:
        return {} if opened.scene is None else clocks_of(opened.scene)
    if opened.external_table is not None or opened.provenance.command != "detect":
        return None
    stated = opened.provenance.parameters.get(CLOCKS, {})
    found = stated.items() if isinstance(stated, Mapping) else ()
    return {name: Clock(name, int(each["offset_ns"]), float(each["drift_ppm"])) for name, each in found}


def stated_clocks(scene: Scene) -> dict[str, object]:
    """Return the entry `CLOCKS` for the provenance of a table: the scene's clocks with an error; empty without any."""
    off = {name: c for name, c in clocks_of(scene).items() if c.offset_ns or c.drift_ppm}
    values = {name: {"offset_ns": c.offset_ns, "drift_ppm": c.drift_ppm} for name, c in off.items()}
    return {CLOCKS: values} if values else {}


def with_applied_clocks(scene: Scene, applied: Mapping[str, Clock]) -> Scene:
    """Return the scene in which cameras without a clock have the clock in `applied` (by camera name), if any."""
    names = {clock.name for clock in scene.clocks}
    added: dict[str, Clock] = {}
    cameras = []
    for camera in scene.cameras:
        clock = applied.get(camera.name) if camera.clock is None else None
        if clock is not None:
            name = clock.name if clock.name and clock.name not in names else f"{camera.name}-recorded"
            while name in names and name not in added:
                name += "-"
            added[name] = replace(clock, name=name)
            names.add(name)
            camera = replace(camera, clock=name)
        cameras.append(camera)
    return replace(scene, cameras=tuple(cameras), clocks=(*scene.clocks, *added.values())) if added else scene


def clock_changes(cameras: Sequence[Camera], scene: Scene, applied: Mapping[str, Clock]) -> dict[int, ClockCorrection]:
    """Return clock changes by camera index, for cameras with another clock in the scene than was applied before.

    Args:
        cameras: cameras in the order of the indices.
        scene: states the clocks that count.
        applied: clocks by camera name that the times were corrected by already; missing: no error.
    """
    stated = clocks_of(scene)
    every = {c: ClockCorrection(applied.get(k.name, RIGHT), stated.get(k.name, RIGHT)) for c, k in enumerate(cameras)}
    return {c: change for c, change in every.items() if change.differs}
