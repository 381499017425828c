"""Whether true positions, true boxes and calibration agree: feet of people, projected, against their boxes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError
from occlog.records.scene import Scene
from occlog.records.tables import Truth, TruthBoxes

MAX_OFF = 0.5
"""Feet may be so many heights of the box from the middle of its lower edge, in the median of a camera."""
LEAST = 20
"""Boxes of a camera from which a median is believed."""


def checked(
    tables: Iterator[Truth | TruthBoxes], scene: Scene, path: Path, note: Callable[[str], None]
) -> Iterator[Truth | TruthBoxes]:
    """The tables; at their end a note says how far feet are from boxes, in heights of the box.

    Raises:
        InputError: they are too far in a camera: the grid of positions, the unit or the camera is another.
    """
    places: list[Truth] = []
    off: dict[str, list[Floats]] = {}
    for table in tables:
        if isinstance(table, Truth):
            places.append(table)
        elif places:
            whole = Truth.merge(places)
            for camera in (c for c in scene.cameras if c.placed):
                mine = table.take((table.sensor == camera.name) & (table.box >= 0) & (table.target_id >= 0))
                off.setdefault(camera.name, []).append(_off(whole, mine, camera.project))
        yield table
    medians = {}
    for name, parts in off.items():
        values = np.concatenate(parts)
        if len(values) < LEAST:
            continue
        medians[name] = float(np.median(values))
        if not medians[name] <= MAX_OFF:
            raise InputError(
                f"{path}: camera {name}: true positions are {medians[name]:.2g} people heights away from their boxes "
                f"(median of {len(values)}; limit {MAX_OFF:g}): another camera, unit or grid of positions"
            )
    if medians:
        told = ", ".join(f"{name} {value:.2g}" for name, value in medians.items())
        note(f"true positions, projected, are beside the feet of true boxes by (median, in heights of the box): {told}")


def _off(truth: Truth, boxes: TruthBoxes, project: Callable[[Floats], Floats]) -> Floats:
    """(n,) distances of projected feet from the middle of the lower edge, in heights; infinity behind the camera."""
    where = {key: row for row, key in enumerate(zip(truth.t_ns.tolist(), truth.target_id.tolist(), strict=True))}
    keys = zip(boxes.t_ns.tolist(), boxes.target_id.tolist(), strict=True)
    pairs = [(row, where[key]) for row, key in enumerate(keys) if key in where]
    if not pairs:
        return np.zeros(0)
    box, place = np.array(pairs, dtype=np.int64).T
    feet = project(np.column_stack([truth.x[place], truth.y[place], np.zeros(len(place))]))
    middle = boxes.left_px[box] + 0.5 * boxes.width_px[box]
    lower = boxes.top_px[box] + boxes.height_px[box]
    away = np.hypot(feet[:, 0] - middle, feet[:, 1] - lower) / boxes.height_px[box]
    return np.where(np.isfinite(away), away, np.inf)
