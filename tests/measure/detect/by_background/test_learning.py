from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from detect_scenes import BLUE, RED, SIZE, STEP_NS, background, broken, camera, frames, replaced, scene, walk

from occlog.core.image import pixel_bin
from occlog.errors import InputError
from occlog.measure.detect.by_background.learning import (
    LearningFrames,
    TargetBox,
    appearance_in_box,
    learn,
    sample_limit,
)
from occlog.measure.detect.by_background.stage import detect
from occlog.measure.detect.config import DetectConfig
from occlog.measure.regions.regions import similarity
from occlog.records.frames import Frame
from occlog.records.tables import Bearings

N = 24
PLACE = scene()

pytestmark = pytest.mark.jit  # whole recordings


def recording() -> list[Frame]:
    return frames(PLACE, N, lambda k: [walk(N)[k]])


def box(**changes: object) -> TargetBox:
    cam = PLACE.camera("a")
    x, y, _ = walk(N)[10]
    foot, head = cam.project(np.array([[x, y, 0.0], [x, y, 1.7]]))
    left, top = np.minimum(foot, head) - 8
    width, height = np.abs(foot - head) + 16
    values = {
        "target_id": 5,
        "sensor": "a",
        "frame": 10,
        "left_px": left,
        "top_px": top,
        "width_px": width,
        "height_px": height,
        **changes,
    }
    return TargetBox(**values)  # type: ignore[arg-type]


def test_the_empty_scene_is_learnt_although_somebody_is_always_there() -> None:
    learned, targets = learn(recording(), PLACE, DetectConfig(), (), 2)
    assert targets == ()
    assert learned.sizes == {}  # the pose tells them
    for cam in PLACE.cameras:
        difference = np.abs(learned.empty[cam.name].astype(float) - background(cam.name)).max(axis=2)
        assert np.percentile(difference, 98) < 12
    parts = list(detect(recording(), PLACE, DetectConfig(), 1, learned))
    assert Bearings.concat(p.bearings for p in parts).seen.all()


@pytest.mark.parametrize("limit", [2, 4, 10])
@pytest.mark.parametrize("count", [1, 3, 10, 57, 200])
def test_samples_are_spread_evenly(limit: int, count: int) -> None:
    kept = LearningFrames(limit)
    for number in range(count):
        if kept.wants(number):
            kept.keep(number, np.full((1, 1), number, dtype=np.uint8))
    numbers = [int(image[0, 0]) for image in kept.images]
    assert numbers == list(range(0, count, kept.stride))[: len(numbers)]
    assert min(count, limit / 2) <= len(numbers) <= limit
    assert numbers[-1] + kept.stride >= count


def test_only_wanted_frames_are_decoded() -> None:
    decoded = []

    def counted(k: int) -> np.ndarray:
        decoded.append(k)
        return background("a").copy()

    items = [Frame(k * STEP_NS, "a", k, lambda k=k: counted(k)) for k in range(400)]
    learn(items, PLACE, DetectConfig())
    # 48 at stride 1, then 24 more at each of the strides 2, 4, 8 and some at 16.
    assert len(decoded) < 48 + 3 * 24 + 24
    assert decoded[-1] > 380


def test_the_memory_for_samples_is_bounded() -> None:
    assert sample_limit(100 * 100 * 3, 4) == 48
    assert sample_limit(1920 * 1080 * 3, 4) == 20
    assert sample_limit(8000 * 6000 * 3, 16) == 12


def test_frames_that_cannot_be_used_are_left_out() -> None:
    items = replaced(recording(), "a", 0, broken)
    items = replaced(items, "a", 3, lambda: np.zeros((10, 10, 3), dtype=np.uint8))
    learned, _ = learn(items, PLACE, DetectConfig())
    assert learned.empty["a"].shape == (SIZE[1], SIZE[0], 3)


def test_a_camera_without_a_usable_frame_is_not_learnt() -> None:
    items = [replace(f, decode=broken) if f.sensor == "a" else f for f in recording()]
    learned, _ = learn(items, PLACE, DetectConfig())
    assert set(learned.empty) == {"b"}


def test_sizes_of_people_are_learnt_where_the_pose_is_not_known() -> None:
    cam = camera("a", 0.0, 0.0, 45.0)
    unknown = scene(replace(cam, placed=False))
    learned, _ = learn(frames(scene(cam), N, lambda k: [walk(N)[k]]), unknown, DetectConfig())
    heights = np.sqrt(12 * learned.sizes["a"].cov[:, 2])
    x, y, _ = walk(N)[N // 2]
    foot, head = cam.project(np.array([[x, y, 0.0], [x, y, 1.7]]))
    assert np.median(heights) == pytest.approx(np.hypot(*(foot - head)), rel=0.15)


def test_a_target_is_learnt_from_a_box_without_what_is_behind_it() -> None:
    _, targets = learn(recording(), PLACE, DetectConfig(), [box(), box(frame=11)])
    assert [t.target_id for t in targets] == [5]
    assert targets[0].appearances.shape == (2, 72)
    red = np.zeros((1, 72))
    red[0, pixel_bin(*RED)] = 1.0
    assert similarity(targets[0].appearances, red).min() > 0.8
    blue = np.zeros((1, 72))
    blue[0, pixel_bin(*BLUE)] = 1.0
    assert similarity(targets[0].appearances, blue).max() < 0.3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"frame": 99}, r"no readable frame 99 of camera 'a'; it has a \(0 to 23\), b \(0 to 23\)"),
        ({"sensor": "z"}, "no readable frame 10 of camera 'z'"),
        ({"left_px": 900.0}, "is outside the image"),
        ({"left_px": 0.0, "top_px": 0.0, "width_px": 9.0, "height_px": 9.0}, "pixels differ from the empty scene"),
    ],
)
def test_a_box_that_shows_no_target_is_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        learn(recording(), PLACE, DetectConfig(), [box(**change)])


def test_without_the_empty_scene_all_of_the_box_counts() -> None:
    image = np.full((20, 30, 3), RED, dtype=np.uint8)
    image[:, 15:] = BLUE
    got = appearance_in_box(image, None, TargetBox(1, "a", 0, 0.0, 0.0, 15.0, 20.0))
    assert got[pixel_bin(*RED)] == 1.0
