"""Mistakes with cameras, which boxes of the same people in several cameras give away."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from occlog.core.geometry.camera import rotation_from_angles
from occlog.records.scene import Camera
from occlog.track.methods.jipda.interface import FrameDetections
from occlog.track.people.camera_checks import camera_faults
from occlog.track.people.camera_checks.camera_faults import MAX_STEPS, CameraFaults
from occlog.track.people.camera_checks.pair_overlap import in_image, projected_people
from occlog.track.people.frame_detections import FrameDetectionsWithIds

SIZE = (1280, 720)
NAMES = ("a", "b", "c", "d")
CORNERS = {"a": (0.0, 0.0, 45.0), "b": (8.0, 0.0, 135.0), "c": (8.0, 6.0, 215.0), "d": (0.0, 6.0, -35.0)}


def cameras() -> list[Camera]:
    """Four cameras in the corners of a room of 8 x 6 m, which point down by 20 degrees."""
    return [
        Camera(
            name=name,
            position=np.array([*CORNERS[name][:2], 2.5]),
            rotation=rotation_from_angles(np.radians(CORNERS[name][2]), np.radians(-20.0), 0.0),
            focal_px=np.array([800.0, 800.0]),
            principal_px=np.array([640.0, 360.0]),
            image_size=SIZE,
        )
        for name in NAMES
    ]


STEP_NS = 100_000_000
Boxes = dict[int, np.ndarray]


def people(seed: int, steps: int, spread: float) -> np.ndarray:
    """(T, 3, 4) x, y, height and width of three people who walk about the middle of the room, up to a distance."""
    rng = np.random.default_rng(seed)
    phase, rate = rng.uniform(0.0, 2.0 * np.pi, (3, 2)), rng.uniform(0.4, 0.8, (3, 2))
    t = 1e-9 * STEP_NS * np.arange(steps)[:, None, None]
    states = np.zeros((steps, 3, 4))
    states[..., :2] = [4.0, 3.0] + spread * np.array([1.6, 1.1]) * np.sin(rate * t + phase)
    states[..., 2], states[..., 3] = 1.7, 0.5
    return states


def found(
    true: list[Camera],
    stated: list[Camera],
    change: Callable[[int, Boxes], Boxes] = lambda _, boxes: boxes,
    seed: int = 0,
    steps: int = 200,
    spread: float = 1.0,
) -> CameraFaults:
    """Boxes of the true cameras of people whom all of them detect, after a change of those of each step."""
    faults, states = CameraFaults(stated), people(seed, steps, spread).reshape(-1, 4)
    shown = [projected_people(each, states) for each in true]
    inside = [in_image(each, np.array(SIZE, dtype=float)) for each in shown]
    for step in range(steps):
        own = slice(3 * step, 3 * step + 3)
        boxes = {c: each[own][seen[own]] for c, (each, seen) in enumerate(zip(shown, inside, strict=True))}
        frames = []
        for c, own in change(step, boxes).items():
            n = len(own)
            none = np.zeros((n, 0))
            detections = FrameDetections(step * STEP_NS, c, own, np.ones(n), np.full(n, -1), none, np.arange(n))
            frames.append(FrameDetectionsWithIds(detections, 0, np.arange(n)))
        faults.add(step * STEP_NS, frames)
    return faults


def reported(faults: CameraFaults, *, doubtful: bool = True) -> dict[tuple[str, ...], str]:
    """Mistakes in words by the names of their cameras."""
    return {tuple(NAMES[c] for c in each.cameras): each.words for each in faults.found("m", doubtful=doubtful)}


def changed(camera: str, **values: object) -> list[Camera]:
    return [replace(each, **values) if each.name == camera else each for each in cameras()]


def inverted(camera: Camera) -> Camera:
    """The camera with extrinsics that are read as their own inverse."""
    return replace(camera, rotation=camera.rotation.T, position=-camera.rotation.T @ camera.position)


@pytest.mark.parametrize("doubtful", [False, True])
def test_nothing_is_stated_of_cameras_that_are_right(doubtful: bool) -> None:
    faults = found(cameras(), cameras())
    assert reported(faults, doubtful=doubtful) == {}
    assert faults.gaps() == []


@pytest.mark.parametrize("name", NAMES[:2])
def test_inverted_extrinsics_are_named(name: str) -> None:
    own = next(each for each in cameras() if each.name == name)
    stated = inverted(own)
    (best,) = found(cameras(), changed(name, rotation=stated.rotation, position=stated.position)).found(
        "m", doubtful=False
    )
    assert best.cameras == (NAMES.index(name),)
    assert best.words.startswith(f"extrinsics of {name} are inverted")
    assert best.fit == 1.0
    assert best.now == 0.0


def test_a_height_that_is_off_is_told_from_a_pitch() -> None:
    own = cameras()[0]
    faults = found(cameras(), changed("a", position=own.position + np.array([0.0, 0.0, 0.5])))
    ((names, words),) = reported(faults).items()
    assert names == ("a",)
    above = re.fullmatch(r"a is ([\d.]+) m below its stated height", words)
    assert above is not None
    assert float(above[1]) == pytest.approx(0.5, abs=0.05)


def test_of_two_cameras_that_do_not_agree_a_height_is_told_from_a_pitch() -> None:
    """A pitch was searched for alone, since boxes of cameras that do not agree were not compared by pairs."""
    own = cameras()[0]
    stated = changed("a", position=own.position + np.array([0.0, 0.0, 0.6]))
    ((names, words),) = reported(found(cameras()[:2], stated[:2])).items()
    assert names == ("a",)
    assert re.match(r"a is 0\.[456]\d? m below its stated height", words)


def test_a_focal_length_that_is_off_is_told_from_other_errors() -> None:
    own = cameras()[1]
    faults = found(cameras(), changed("b", focal_px=1.25 * own.focal_px))
    ((names, words),) = reported(faults).items()
    assert names == ("b",)
    long = re.fullmatch(r"the focal length of b is ([\d.]+)% too long", words)
    assert long is not None
    assert float(long[1]) == pytest.approx(25.0, abs=3.0)


def test_inverted_extrinsics_of_all_cameras_are_named_together() -> None:
    faults = found(cameras(), [inverted(each) for each in cameras()])
    assert reported(faults) == {NAMES: "extrinsics of all cameras are inverted (camera-to-world for world-to-camera)"}


def test_exchanged_files_are_named_once_for_both_cameras() -> None:
    right = cameras()
    (words,) = reported(found([right[1], right[0], right[2], right[3]], right), doubtful=False).values()
    assert words in ("boxes of a and b are exchanged", "boxes of b and a are exchanged")


@pytest.mark.parametrize(("factor", "mended"), [(2.0, "0.5"), (2.0 / 3.0, "1.5")])
def test_boxes_of_images_of_another_size_are_named_with_the_factor(factor: float, mended: str) -> None:
    def scaled(which: tuple[int, ...]) -> Callable[[int, Boxes], Boxes]:
        return lambda _, boxes: {c: factor * each if c in which else each for c, each in boxes.items()}

    words = f"are multiplied by {mended} (images of another size)"
    assert reported(found(cameras(), cameras(), scaled((2,)))) == {("c",): f"boxes of c {words}"}
    assert reported(found(cameras(), cameras(), scaled((0, 1, 2, 3)))) == {NAMES: f"boxes of all cameras {words}"}


def corners_for_sizes(boxes: np.ndarray) -> np.ndarray:
    return np.hstack([boxes[:, :2], boxes[:, :2] + boxes[:, 2:]])


def centres_for_corners(boxes: np.ndarray) -> np.ndarray:
    return boxes + np.tile(0.5 * (boxes[:, 2:] - boxes[:, :2]), 2)


def corners_for_centres(boxes: np.ndarray) -> np.ndarray:
    return np.hstack([boxes[:, :2] - 0.5 * boxes[:, 2:], boxes[:, :2] + 0.5 * boxes[:, 2:]])


def left_top_for_centres(boxes: np.ndarray) -> np.ndarray:
    return boxes - np.tile(0.5 * (boxes[:, 2:] - boxes[:, :2]), 2)


def shares_of_squares(boxes: np.ndarray) -> np.ndarray:
    return (boxes + np.array([0, 280, 0, 280])) * [1.0, 720 / 1280, 1.0, 720 / 1280]


def rows_for_columns(boxes: np.ndarray) -> np.ndarray:
    return boxes[:, [1, 0, 3, 2]]


def share_rows_for_columns(boxes: np.ndarray) -> np.ndarray:
    return rows_for_columns(boxes) * np.tile([SIZE[0] / SIZE[1], SIZE[1] / SIZE[0]], 2)


def height_for_width(boxes: np.ndarray) -> np.ndarray:
    return np.hstack([boxes[:, :2], boxes[:, :2] + (boxes[:, 2:] - boxes[:, :2])[:, ::-1]])


def rotated_clockwise(boxes: np.ndarray) -> np.ndarray:
    left, top, right, bottom = boxes.T
    return np.column_stack([SIZE[1] - bottom, left, SIZE[1] - top, right])


def rotated_anticlockwise(boxes: np.ndarray) -> np.ndarray:
    left, top, right, bottom = boxes.T
    return np.column_stack([top, SIZE[0] - right, bottom, SIZE[0] - left])


def thousandths(boxes: np.ndarray) -> np.ndarray:
    return 1000.0 * boxes / np.tile(SIZE, 2)


def thousandths_of_rows(boxes: np.ndarray) -> np.ndarray:
    return rows_for_columns(thousandths(boxes))


def of_heads(boxes: np.ndarray) -> np.ndarray:
    size, middle = boxes[:, 2:] - boxes[:, :2], 0.5 * (boxes[:, 0] + boxes[:, 2])
    left, right = (middle + sign * 0.25 * size[:, 0] for sign in (-1, 1))
    return np.column_stack([left, boxes[:, 1], right, boxes[:, 1] + size[:, 1] / 7.0])


def larger(boxes: np.ndarray) -> np.ndarray:
    size = boxes[:, 2:] - boxes[:, :2]
    return boxes + 0.15 * np.hstack([-size, size])


FORMS = [
    (thousandths, "thousandths of the image"),
    (thousandths_of_rows, "thousandths of the image with y, x in place of x, y"),
    (of_heads, "of heads (give boxes of whole bodies)"),
    (larger, "30% too large about their centres"),
    (rows_for_columns, "y, x in place of x, y"),
    (share_rows_for_columns, "y, x in place of x, y (as shares)"),
    (height_for_width, "of exchanged widths and heights"),
    (rotated_clockwise, "of images rotated by 90 degrees clockwise"),
    (rotated_anticlockwise, "of images rotated by 90 degrees anticlockwise"),
    (corners_for_sizes, "left, top, right, bottom (xyxy), read as left, top, width, height"),
    (centres_for_corners, "centres and sizes, read as left, top, width, height"),
    (corners_for_centres, "left, top, right, bottom (xyxy), read as centres and sizes"),
    (left_top_for_centres, "left, top, width, height, read as centres and sizes"),
    (shares_of_squares, "shares of square images with bars (letterbox)"),
]


@pytest.mark.parametrize(("misread", "words"), FORMS)
def test_numbers_of_boxes_that_mean_something_else_are_named(
    misread: Callable[[np.ndarray], np.ndarray], words: str
) -> None:
    def one(_step: int, boxes: Boxes) -> Boxes:
        return {c: misread(own) if c == 1 else own for c, own in boxes.items()}

    def every(_step: int, boxes: Boxes) -> Boxes:
        return {c: misread(own) for c, own in boxes.items()}

    assert reported(found(cameras(), cameras(), one)) == {("b",): f"boxes of b are {words}"}
    if misread in (corners_for_sizes, shares_of_squares, thousandths, larger):
        assert reported(found(cameras(), cameras(), every)) == {NAMES: f"boxes of all cameras are {words}"}


@pytest.mark.parametrize(("ratio", "rate"), [(2, "5"), (3, "3.333")])
def test_a_camera_of_another_rate_that_counts_its_own_frames_is_named_with_its_rate(ratio: int, rate: str) -> None:
    faults = found(cameras(), cameras())
    boxes = [each.get(1) for _, each in faults._samples]
    for step, (_, each) in enumerate(faults._samples):
        each.pop(1, None)
        if ratio * step < len(boxes) and boxes[ratio * step] is not None:
            each[1] = boxes[ratio * step]
    words = f"b has another frame rate (ingest --fps b={rate})"
    assert reported(faults, doubtful=False) == {("b",): words}


def test_boxes_of_one_camera_that_are_too_large_are_no_focal_length() -> None:
    def one(_step: int, boxes: Boxes) -> Boxes:
        return {c: larger(own) if c == 1 else own for c, own in boxes.items()}

    assert errors(found(cameras(), cameras(), one)) == {("b",): "boxes of b are 30% too large about their centres"}


def test_two_cameras_exchanged_for_a_while_are_named_with_the_time() -> None:
    def exchanged(step: int, boxes: Boxes) -> Boxes:
        return {**boxes, 0: boxes[3], 3: boxes[0]} if 60 <= step < 120 else boxes

    (words,) = reported(found(cameras(), cameras(), exchanged), doubtful=False).values()
    assert words.startswith(("boxes of a and d are exchanged from", "boxes of d and a are exchanged from"))
    begin, end = (float(word) for word in words.split() if word.replace(".", "").isdigit())
    assert abs(begin - 6.0) <= 1.5
    assert abs(end - 12.0) <= 1.5


def test_boxes_of_half_the_size_from_a_time_on_are_named_with_it() -> None:
    def half(step: int, boxes: Boxes) -> Boxes:
        return {**boxes, 1: 0.5 * boxes[1]} if step >= 100 else boxes

    (words,) = reported(found(cameras(), cameras(), half)).values()
    assert words.startswith("boxes of b are multiplied by 2 (images of another size) from")
    assert abs(float(words.split()[-4]) - 10.0) <= 1.5


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("begin", "dropped"), [(90, 20), (60, 10), (120, 30)])
def test_frames_of_one_camera_that_are_dropped_and_not_counted_are_named_with_time_and_size(
    begin: int, dropped: int, seed: int
) -> None:
    """Later boxes are early by the frames that were lost; they were taken for a rotation."""
    kept: list[np.ndarray] = []
    found(cameras(), cameras(), lambda _, boxes: kept.append(boxes[1]) or boxes, seed=seed)

    def early(step: int, boxes: Boxes) -> Boxes:
        if step < begin:
            return boxes
        late = step + dropped
        return {k: kept[late] if k == 1 and late < 200 else v for k, v in boxes.items() if k != 1 or late < 200}

    (names, words), *others = reported(found(cameras(), cameras(), early, seed=seed)).items()
    assert (names, others) == (("b",), [])
    got = re.fullmatch(r"the clock of b is ([\d.]+) s behind from ([\d.]+) to [\d.]+ s", words)
    assert got is not None
    assert float(got[1]) == pytest.approx(0.1 * dropped, rel=0.2)
    assert float(got[2]) == pytest.approx(0.1 * begin, abs=2.0)


def test_a_part_is_not_searched_if_most_of_its_steps_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of many boxes some steps are compared; the other ones show whether those are typical."""

    def shifted(step: int, boxes: Boxes) -> Boxes:
        return boxes if step % 4 or not 60 <= step < 130 else {**boxes, 0: boxes[0] - [300.0, 0.0, 300.0, 0.0]}

    monkeypatch.setattr(camera_faults, "MAX_BOXES", 600)
    monkeypatch.setattr(camera_faults._Search, "_best", lambda *_, **__: pytest.fail("the part is searched"))
    assert reported(found(cameras(), cameras(), shifted), doubtful=False) == {}


def test_a_camera_that_was_pushed_is_named_with_its_rotation() -> None:
    own = cameras()[1]
    turn = rotation_from_angles(np.radians(CORNERS["b"][2] + 4.0), np.radians(-20.0), 0.0)
    (words,) = reported(found(changed("b", rotation=turn), cameras()), doubtful=True).values()
    assert words.startswith("b is rotated by +")
    assert abs(float(words.split()[4]) - 4.0 * np.cos(np.radians(20.0))) < 0.6
    assert own.name == "b"


def errors(faults: CameraFaults) -> dict[tuple[str, ...], str]:
    """Errors of calibrations in words by the names of their cameras."""
    return {tuple(NAMES[c] for c in cameras): words for cameras, words in faults.errors("m")}


@pytest.mark.parametrize("turn_deg", [0.6, 3.0])
def test_a_camera_that_is_pushed_by_little_during_the_recording_is_named_with_the_time(turn_deg: float) -> None:
    turn = rotation_from_angles(np.radians(CORNERS["b"][2] + turn_deg), np.radians(-20.0), 0.0)
    pushed = found(changed("b", rotation=turn), cameras())._samples
    faults = found(cameras(), cameras())
    # The first 12 of 20 s are of the camera as it was
    faults._samples[120:] = pushed[120:]
    ((names, words),) = errors(faults).items()
    assert names == ("b",)
    assert words.startswith("b is rotated by +")
    assert abs(float(words.split()[4]) - turn_deg * np.cos(np.radians(20.0))) < 0.1 + 0.05 * turn_deg
    assert abs(float(words.split()[-3]) - 12.0) <= 0.1


def test_a_camera_that_was_calibrated_after_it_was_pushed_is_rotated_until_then() -> None:
    turn = rotation_from_angles(np.radians(CORNERS["b"][2] + 2.0), np.radians(-20.0), 0.0)
    pushed = found(changed("b", rotation=turn), cameras())._samples
    faults = found(cameras(), cameras())
    faults._samples[:90] = pushed[:90]
    words = errors(faults)[("b",)]
    assert abs(float(words.split()[4]) - 2.0 * np.cos(np.radians(20.0))) < 0.2
    assert words.endswith("until 9.0 s")


def test_cameras_that_are_right_have_no_error() -> None:
    assert errors(found(cameras(), cameras())) == {}


@pytest.mark.parametrize("bent_cameras", [("c",), NAMES])
def test_lenses_of_another_distortion_are_named_with_the_offset(bent_cameras: tuple[str, ...]) -> None:
    bent = np.array([-0.2, 0.08, 0.0, 0.0, 0.0])
    true = [replace(each, distortion=bent) if each.name in bent_cameras else each for each in cameras()]
    ((names, words),) = errors(found(true, cameras(), spread=1.9)).items()
    assert names == bent_cameras
    assert words.startswith(f"the lens of {bent_cameras[0] if len(bent_cameras) == 1 else 'all cameras'} is off by +")
    offsets = [float(word) for word in words.split() if word[0] == "+"]
    # 0.2 r^3 f, for boxes of which 95 % are within 0.6 to 0.8 focal lengths of the middle
    assert all(0.2 * 800.0 * 0.5**3 < offset < 0.2 * 800.0 * 0.9**3 for offset in offsets)


def test_a_focal_length_that_is_stated_too_long_is_named_with_its_error() -> None:
    focal = next(each for each in cameras() if each.name == "c").focal_px
    words = errors(found(cameras(), changed("c", focal_px=1.05 * focal)))[("c",)]
    assert words.startswith("the focal length of c is ")
    assert words.endswith("% too long")
    assert abs(float(words.split()[6].rstrip("%")) - 5.0) < 0.3


def test_a_camera_above_its_stated_height_is_named_with_the_difference() -> None:
    own = next(each for each in cameras() if each.name == "d").position
    words = errors(found(cameras(), changed("d", position=own - [0.0, 0.0, 0.3])))[("d",)]
    assert words.startswith("d is 0.")
    assert words.endswith(" m above its stated height")
    assert abs(float(words.split()[2]) - 0.3) < 0.03


@pytest.mark.parametrize("late", [1, -3])
def test_a_camera_with_another_clock_is_named_with_its_delay(late: int) -> None:
    faults = found(cameras(), cameras())
    boxes = [each.get(0) for _, each in faults._samples]
    for k, (_, each) in enumerate(faults._samples):
        each.pop(0, None)
        if 0 <= k - late < len(boxes) and boxes[k - late] is not None:
            each[0] = boxes[k - late]
    words = errors(faults)[("a",)]
    assert words.startswith("the clock of a is ")
    assert words.endswith("ahead" if late > 0 else "behind")
    assert abs(float(words.split()[5]) - 0.1 * abs(late)) < 0.01


def test_times_without_boxes_are_found_where_others_see_people() -> None:
    def truncated(step: int, boxes: Boxes) -> Boxes:
        return {c: each for c, each in boxes.items() if c != 2 or step < 120}

    (gap,) = found(cameras(), cameras(), truncated).gaps()
    assert (gap.camera, gap.begin_s, gap.end_s) == (2, 12.0, 19.9)


def test_memory_does_not_grow_with_the_recording() -> None:
    faults = found(cameras(), cameras(), steps=5 * MAX_STEPS)
    assert MAX_STEPS // 2 <= len(faults._samples) <= MAX_STEPS
