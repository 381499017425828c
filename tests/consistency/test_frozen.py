"""Cameras that repeat a frame while others go on, and those that have a reason to."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.array_types import NS
from occlog.consistency.frozen import FrozenCameras
from occlog.records.tables import Boxes

STEP_NS = NS // 10


def frames(frozen: FrozenCameras, camera: str, contents: list[int | None]) -> None:
    for n, content in enumerate(contents):
        frozen.add(camera, n * STEP_NS, content)


def found(**cameras: list[int | None]) -> list[tuple[str, int, int]]:
    """Camera, first frame and number of identical frames."""
    frozen = FrozenCameras()
    for name, contents in cameras.items():
        frames(frozen, name, contents)
    return [(run.camera, run.first_ns // STEP_NS, run.frames) for run in frozen.found()]


MOVING: list[int | None] = list(range(200))


def test_a_camera_that_repeats_its_frame_for_three_seconds_is_found() -> None:
    assert found(a=MOVING, b=[*range(99), *[99] * 31]) == [("b", 99, 31)]
    assert found(a=MOVING, b=[*range(99), *[99] * 30]) == []
    assert found(a=MOVING, b=[*range(20), *[20] * 40, *range(21, 100), *[5] * 60]) == [("b", 139, 60)]


def test_cameras_that_stand_still_together_and_empty_frames_are_no_fault() -> None:
    assert found(a=[*range(50), *[50] * 100], b=[*range(50), *[50] * 100]) == []
    assert found(a=MOVING, b=[None] * 200) == []
    assert found(b=[7] * 200) == []


def test_a_camera_that_moves_at_another_time_shows_nothing() -> None:
    frozen = FrozenCameras()
    frames(frozen, "b", [7] * 100)
    for n in range(100):
        frozen.add("a", (1000 + n) * STEP_NS, n)
    assert list(frozen.found()) == []


def boxes(camera: str, times: range, seed: int | None) -> Boxes:
    """Three boxes a frame, drawn again for each frame unless `seed` is given."""
    rng = np.random.default_rng(1)
    n = 3 * len(times)
    edges = rng.uniform(0.0, 100.0, (n, 4)) if seed is None else np.tile(np.arange(12.0).reshape(3, 4), (len(times), 1))
    return Boxes.of(
        t_ns=np.repeat(np.array(times, dtype=np.int64) * STEP_NS, 3),
        sensor=np.full(n, camera),
        frame=np.repeat(np.array(times, dtype=np.int64), 3),
        box=np.tile(np.arange(3), len(times)),
        target_id=np.full(n, -1),
        left_px=edges[:, 0],
        top_px=edges[:, 1],
        width_px=1.0 + edges[:, 2],
        height_px=1.0 + edges[:, 3],
        confidence=np.full(n, np.nan),
    )


@pytest.mark.parametrize("parts", [1, 7])
def test_boxes_in_parts(parts: int) -> None:
    frozen = FrozenCameras()
    for part in np.array_split(np.arange(100), parts):
        times = range(int(part[0]), int(part[-1]) + 1)
        frozen.add_boxes(Boxes.merge([boxes("a", times, None), boxes("b", times, 0)]))
    (run,) = frozen.found()
    assert (run.camera, run.first_ns, run.frames) == ("b", 0, 100)
