"""Boxes of each camera go to its own tracker, frame by frame; boxes of no one are left out."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from occlog.errors import PluginError
from occlog.plugins.interface import BoxesInFrame
from occlog.plugins.loading import VIEW_TRACKER, Plugin
from occlog.records.tables import Boxes
from occlog.track.single_view.stage import CameraTrackers, follow

PLUGIN = Plugin(VIEW_TRACKER, "mine", "mine:Mine", "my-package", "1")


class ByWidth:
    """Who is as wide is the same; boxes of less than 10 px are of no one."""

    def __init__(self) -> None:
        self.seen: list[BoxesInFrame] = []

    def step(self, found: BoxesInFrame) -> Any:
        self.seen.append(found)
        wide = found.boxes[:, 2]
        return np.where(wide < 10, -1, wide.astype(np.int64))


def boxes(rows: list[tuple[int, str, float]]) -> Boxes:
    """Rows of time, camera and width; a width of 0 is a frame without a box."""
    t_ns, sensor, width = (np.array(column) for column in zip(*rows, strict=True))
    there = width > 0
    numbers = [sum(rows[k][:2] == rows[n][:2] for k in range(n)) if there[n] else -1 for n in range(len(rows))]
    edge = np.where(there, 1.0, np.nan)
    return Boxes.of(
        t_ns=t_ns, sensor=sensor, frame=t_ns, box=np.array(numbers, dtype=np.int32),
        target_id=np.full(len(rows), 5, dtype=np.int32), left_px=edge, top_px=edge, height_px=edge,
        width_px=np.where(there, width, np.nan), confidence=0.5 * edge,
    )  # fmt: skip


ROWS = [(0, "a", 20.0), (0, "a", 30.0), (0, "b", 20.0), (1, "a", 30.0), (1, "a", 4.0), (1, "b", 4.0), (2, "a", 0.0)]


@pytest.mark.parametrize("cuts", [(), (1,), (4,), (1, 2, 3, 4, 5, 6)])
def test_identities_are_of_one_camera_and_chunks_do_not_matter(cuts: tuple[int, ...]) -> None:
    own: dict[str, ByWidth] = {}
    trackers = CameraTrackers(PLUGIN, lambda name: own.setdefault(name, ByWidth()))
    whole = boxes(ROWS)
    chunks = [whole.take(slice(a, b)) for a, b in zip((0, *cuts), (*cuts, len(whole)), strict=True)]
    found = Boxes.concat(follow(chunks, trackers, lambda _: True))
    reported = list(zip(found.t_ns.tolist(), found.sensor.tolist(), found.target_id.tolist(), strict=True))
    assert reported == [(0, "a", 0), (0, "a", 1), (0, "b", 2), (1, "a", 1), (1, "b", -1), (2, "a", -1)]
    assert found.box.tolist() == [0, 1, 0, 0, -1, -1]
    assert np.isnan(found.width_px[4:]).all()
    assert [len(each.boxes) for each in own["a"].seen] == [2, 2, 0]
    assert [len(each.boxes) for each in own["b"].seen] == [1, 1]
    assert (trackers.frames, trackers.boxes, trackers.unassigned) == (5, 6, 2)
    assert trackers.cameras == ["a", "b"]


def test_cameras_that_are_not_used_are_not_asked() -> None:
    trackers = CameraTrackers(PLUGIN, lambda _: ByWidth())
    found = Boxes.concat(follow([boxes(ROWS)], trackers, lambda name: name == "b"))
    assert set(found.sensor.tolist()) == {"b"}
    assert trackers.cameras == ["b"]


@pytest.mark.parametrize(
    ("ids", "words"),
    [
        (np.zeros(1, dtype=np.int64), r"step gives the shape \(1,\); \(2,\) was expected"),
        (np.array([0.0, 1.0]), "step gives values of kind float64; whole numbers"),
        (np.array([3, 3]), "identity 3 is twice in one frame"),
        (np.array([-2, 3]), "identity -2 must be at least 0"),
        ([[1], [1, 2]], "step gives lists of different lengths"),
    ],
)
def test_what_no_identities_can_be_is_named(ids: Any, words: str) -> None:
    class Gives:
        def step(self, found: BoxesInFrame) -> Any:
            return ids

    with pytest.raises(PluginError, match=rf"plug-in mine \(my-package 1\): camera a: frame 0: {words}"):
        list(follow([boxes(ROWS)], CameraTrackers(PLUGIN, lambda _: Gives()), lambda _: True))
