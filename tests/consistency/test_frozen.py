"""Cameras that repeat a frame while others go on, and those that have a reason to."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.array_types import NS
from occlog.consistency.frozen import FrozenCameras, FrozenValues, RepeatedBoxes
from occlog.records.tables import Bearings, Boxes
from occlog.records.verdicts import findings

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


def as_boxes(camera: str, contents: list[int | None]) -> Boxes:
    """A box in each frame, at a place of its own for each content; None: the frame has no box."""
    N, nan = len(contents), np.nan
    left = np.array([nan if c is None else 7.0 * c for c in contents])
    return Boxes.of(
        t_ns=np.arange(N) * STEP_NS,
        sensor=np.full(N, camera),
        frame=np.arange(N),
        box=np.where(np.isnan(left), -1, 0),
        target_id=np.full(N, -1),
        left_px=left,
        top_px=left,
        width_px=0.0 * left + 50.0,
        height_px=0.0 * left + 150.0,
        confidence=np.full(N, nan),
    )


def repeated(**cameras: list[int | None]) -> RepeatedBoxes:
    out = RepeatedBoxes()
    for part in (slice(0, 90), slice(90, None)):
        out.add_boxes(Boxes.merge([as_boxes(name, each).take(part) for name, each in cameras.items()]))
    return out


def test_boxes_that_change_in_every_fourth_frame_are_found() -> None:
    held = [n // 4 for n in range(200)]
    assert repeated(a=held, b=[None if 40 < c < 43 else c for c in held]).held() == {4: ["a", "b"]}
    assert repeated(a=held).lag_ns(["a"], 4) == 3 * STEP_NS
    # Each frame has its own, one that stands in whole pixels, and one that stands for some time
    stands = np.random.default_rng(3).integers(1, 6, 60)
    irregular = np.repeat(np.arange(60), stands).tolist()
    assert repeated(a=MOVING, b=irregular, c=[*range(100), *[100] * 100]).held() == {}


def test_a_part_that_is_played_again_is_found_with_its_time() -> None:
    again: list[int | None] = [*range(100), *range(100)]
    (part,) = repeated(a=MOVING, b=again).looped()
    assert (part.camera, part.first_ns, part.frames, part.later_ns) == ("b", 100 * STEP_NS, 100, 100 * STEP_NS)
    # A path that returns, one place that is visited again, and a simulation that is periodic in all cameras
    assert list(repeated(a=MOVING, b=[*range(100), *range(99, -1, -1)]).looped()) == []
    assert list(repeated(a=MOVING, b=[*range(100), *[5] * 100]).looped()) == []
    assert list(repeated(a=again, b=again).looped()) == []
    assert list(repeated(a=MOVING, b=[7] * 200).looped()) == []


def named(of_b: np.ndarray, step: float = 1e-4) -> list[str]:
    """Findings of bearings at 10 Hz of a sensor, next to noisy ones of another sensor, both in steps [rad]."""
    N = len(of_b)
    others = 0.5 + 0.05 * np.random.default_rng(8).standard_normal(N)
    blank = np.full(2 * N, np.nan)
    table = Bearings.of(
        t_ns=np.repeat(np.arange(N) * STEP_NS, 2),
        sensor=np.tile(["a", "b"], N),
        target_id=np.full(2 * N, -1, dtype=np.int32),
        seen=np.ones(2 * N, dtype=np.bool_),
        bearing=step * np.round(np.column_stack([others, of_b]).ravel() / step),
        sigma=np.full(2 * N, 0.05),
        u_px=blank,
        sigma_px=blank,
        score=blank,
    )
    frozen = FrozenValues()
    assert sum(map(len, frozen.watch([table.take(slice(0, 150)), table.take(slice(150, None))]))) == 2 * N
    return [check.text for check in findings(frozen.checks())]


SECONDS = np.arange(200) / 10.0
ROUGH = 0.1 * SECONDS + 0.02 * np.random.default_rng(9).standard_normal(200)


def test_a_sensor_that_repeats_its_last_value_is_named_with_the_time() -> None:
    (text,) = named(np.where(SECONDS < 12.0, ROUGH, ROUGH[119]))
    assert "b: 81 identical bearings in 8 s from 11.9 s" in text


def test_values_that_repeat_rightly_are_not_named() -> None:
    stands = np.clip(SECONDS - 12.0, None, 0.0)
    # In whole degrees, without noise of the sensor, and at a path through the sensor
    assert named(np.where(SECONDS < 12.0, ROUGH, ROUGH[119]), step=np.radians(2.0)) == []
    assert named(0.1 * stands) == []
    assert named(np.sin(stands)) == []
    assert named(np.sin(stands), step=1e-12) == []
    assert named(ROUGH) == []
    assert named(np.full(200, 0.3)) == []
    # A slow sensor whose value is repeated for 4 s again and again
    assert named(np.repeat(ROUGH[::40], 40)) == []
