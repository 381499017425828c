"""Sensors that may be added, ranked by the error over the floor with each; and the scene's own, by that without each.

All are judged on the same walks and crowds, with errors made of the same numbers, so that differences are known
better than the errors themselves.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.core.sight.camera import angles_from_rotation, rotation_from_angles
from occlog.records.scene import Camera, Scene

from .sensing import Sensor, Told, told_by
from .stage import Planned, expected_error, sensors_of


class Placed(NamedTuple):
    """A sensor, and the error over the floor with it (or without it)."""

    sensor: Sensor
    rmse: float


def rank_candidates(planned: Planned, candidates: Iterable[Sensor], also: Sequence[Told] = ()) -> list[Placed]:
    """Each candidate added to the scene's sensors, the best one first; equal ones in the order given."""
    told = [_sum([*planned.told.values(), *also])] if planned.told or also else []
    found = []
    for sensor in candidates:
        own = told_by(sensor, planned.scene, planned.walked, planned.config, planned.seed)
        found.append(Placed(sensor, expected_error(planned, [*told, own])))
    return sorted(found, key=lambda placed: placed.rmse)


def add_greedily(planned: Planned, ranked: Sequence[Placed], count: int) -> Iterator[Placed]:
    """One sensor after the other, each time the one that lowers the expected error most."""
    also: list[Told] = []
    left = list(ranked)
    for _ in range(min(count, len(ranked))):
        best = left[0]
        yield best
        also.append(told_by(best.sensor, planned.scene, planned.walked, planned.config, planned.seed))
        rest = [placed.sensor for placed in left[1:]]
        left = rank_candidates(planned, rest, also)


def rank_own(planned: Planned) -> list[Placed]:
    """The error without each of the scene's sensors, the least needed one first."""
    found = []
    for sensor in sensors_of(planned.scene):
        others = [told for name, told in planned.told.items() if name != sensor.name]
        found.append(Placed(sensor, expected_error(planned, others)))
    return sorted(found, key=lambda placed: placed.rmse)


def _sum(told: Sequence[Told]) -> Told:
    """All that several sensors tell, as if of one."""
    seen, information = told[0].seen.copy(), told[0].information.copy()
    for one in told[1:]:
        seen |= one.seen
        information += one.information
    return Told(seen, information)


def along_walls(scene: Scene, like: Camera, spacing: float) -> tuple[Camera, ...]:
    """Copies of a camera along the walls, each looking at the middle of the room.

    Args:
        scene: with a room.
        like: its lens, noise and rate.
        spacing: between two places on a wall at most; corners are places.
    """
    assert scene.room is not None
    middle = scene.room.mean(axis=0)
    out: list[Camera] = []
    for a, b in zip(scene.room, np.roll(scene.room, -1, axis=0), strict=True):
        parts = max(1, int(np.ceil(np.hypot(*(b - a)) / spacing)))
        for share in np.arange(parts) / parts:
            place = a + share * (b - a)
            place = place + 1e-3 * (middle - place)
            out.append(_turned(like, place, middle, f"wall{len(out) + 1}"))
    return tuple(out)


def _turned(like: Camera, place: Floats, to: Floats, name: str) -> Camera:
    """The camera at a place, with its pitch, looking to another."""
    _, pitch, roll = angles_from_rotation(like.rotation)
    yaw = float(np.arctan2(*(to - place)[::-1]))
    position = np.array([place[0], place[1], like.position[2]])
    return replace(like, name=name, position=position, rotation=rotation_from_angles(yaw, pitch, roll))
