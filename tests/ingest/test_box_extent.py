"""Sizes of images by the ends of boxes, sizes that are given, and boxes that a wide fisheye does not see well."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from occlog.array_types import Floats
from occlog.cli.main import run
from occlog.errors import ExitCode, spelled
from occlog.ingest.box_extent import BoxExtents
from occlog.io.recording.reader import open_recording
from occlog.records.tables import Boxes
from occlog.records.verdicts import Check

SIZE = (1920, 1080)


def boxes(name: str, rng: np.random.Generator, size: tuple[int, int], clip: tuple[int, int] | None = None) -> Boxes:
    """Boxes of people anywhere in images of a size, the near ones over the lower border, ended at `clip`."""
    n = 300
    left, top = rng.uniform(0, 0.95 * size[0], n), rng.uniform(0.1, 0.7, n) * size[1]
    height = (0.1 + 0.5 * top / size[1]) * size[1] * rng.uniform(0.8, 1.2, n)
    right, bottom = left + 0.4 * height, top + height
    if clip is not None:
        right, bottom = np.minimum(right, clip[0] - 1), np.minimum(bottom, clip[1] - 1)
    return Boxes.of(
        t_ns=np.arange(n),
        sensor=[name] * n,
        frame=np.arange(n),
        box=np.zeros(n, dtype=int),
        left_px=left,
        top_px=top,
        width_px=right - left,
        height_px=bottom - top,
        confidence=np.full(n, np.nan),
        target_id=np.full(n, -1),
    )


def warning(sizes: Mapping[str, tuple[int, int]], tables: list[Boxes], known: tuple[str, ...] = ()) -> str | None:
    checks = found(sizes, tables, known)
    assert all(check.status == "failed" for check in checks)
    return spelled(checks[0].text) if checks else None


def found(sizes: Mapping[str, tuple[int, int]], tables: list[Boxes], known: tuple[str, ...] = ()) -> list[Check]:
    extents = BoxExtents(sizes)
    for table in tables:
        extents.add(table)
    return [check for check in extents.checks(known) if check.found]


@pytest.mark.parametrize("exchanged", [False, True])
def test_columns_of_frames_and_identities_that_are_exchanged_are_reported(exchanged: bool) -> None:
    """Five people who walk for 40 frames."""
    order = "xy" if exchanged else "ij"
    frame, person = (each.ravel() for each in np.meshgrid(np.arange(40), np.arange(5), indexing=order))
    table = Boxes.of(
        t_ns=person if exchanged else frame,
        sensor=["a"] * 200,
        frame=person if exchanged else frame,
        box=np.zeros(200, dtype=int),
        left_px=300.0 * person + 2.0 * frame,
        top_px=np.full(200, 100.0),
        width_px=np.full(200, 40.0),
        height_px=np.full(200, 100.0),
        confidence=np.full(200, np.nan),
        target_id=frame if exchanged else person,
    )
    ids = [check.id for check in found({"a": SIZE}, [table])]
    assert ids == (["boxes-frame-id-exchanged"] if exchanged else [])


@pytest.mark.parametrize("size", [(1920, 1080), (1280, 720), (640, 480), (1024, 1024)])
@pytest.mark.parametrize("whole", [100, 1000])
def test_boxes_in_percents_and_thousandths_are_reported(size: tuple[int, int], whole: int) -> None:
    rng = np.random.default_rng(4)
    ids = [
        check.id
        for check in found(
            {"a": size, "b": size}, [boxes(name, rng, (whole, whole), (whole + 1, whole + 1)) for name in "ab"]
        )
    ]
    assert ("boxes-in-parts" in ids) == (size[0] != size[1])
    right = [boxes(name, rng, size, size) for name in "ab"]
    assert "boxes-in-parts" not in [check.id for check in found({"a": size, "b": size}, right)]


@pytest.mark.parametrize("true", [(1280, 720), (640, 360), (960, 540), (3840, 2160)])
def test_boxes_that_end_at_another_size_are_reported_with_the_factor(true: tuple[int, int]) -> None:
    rng = np.random.default_rng(4)
    message = warning({"a": SIZE, "b": SIZE}, [boxes(name, rng, true, true) for name in "ab"])
    assert message is not None
    factor = max(true[0] / 1920, 1920 / true[0])
    assert f"reach to {true[0]} x {true[1]} px, though images have 1920 x 1080 px (factor {factor:.4g})" in message
    assert f"{true[0]}x{true[1]}, which scales the calibration" in message
    known = warning({"a": SIZE, "b": SIZE}, [boxes(name, rng, true, true) for name in "ab"], ("a", "b"))
    assert known is not None
    assert "give boxes in pixels of these images" in known


def test_boxes_of_larger_images_are_reported_where_no_border_ends_them() -> None:
    rng = np.random.default_rng(4)
    message = warning({"a": (960, 540)}, [boxes("a", rng, SIZE)])
    assert message is not None
    assert "of its boxes end beyond its images" in message


@pytest.mark.parametrize("name", ["a", "b"])
def test_boxes_wider_than_high_are_named_with_the_camera_if_it_is_upright(name: str) -> None:
    table = boxes(name, np.random.default_rng(4), SIZE)
    turned = replace(
        table, left_px=table.top_px, top_px=table.left_px, width_px=table.height_px, height_px=table.width_px
    )
    extents = BoxExtents({}, upright=["a"])
    extents.add(turned)
    (check,) = extents.checks(())
    assert check.found == (name == "a")
    assert not check.found or (check.id, check.sensors) == ("boxes-wide", ("a",))
    upright = BoxExtents({}, upright=["a"])
    upright.add(table)
    assert not any(each.found for each in upright.checks(()))


def test_corners_for_sizes_are_named_with_the_camera() -> None:
    rng = np.random.default_rng(4)
    right = [boxes(name, rng, SIZE, SIZE) for name in "ab"]
    far = [(each.left_px + each.width_px, each.top_px + each.height_px) for each in right]
    wrong = replace(right[1], width_px=far[1][0], height_px=far[1][1])
    (check,) = found(dict.fromkeys("ab", SIZE), [right[0], wrong])
    assert (check.id, check.sensors) == ("boxes-corners", ("b",))
    extents = BoxExtents(dict.fromkeys("ab", SIZE), upright=["a", "b"])
    for table in (right[0], wrong):
        extents.add(table)
    assert [check.id for check in extents.checks(()) if check.found] == ["boxes-corners"]
    # Of larger images, and not of corners
    (check,) = found({"a": (960, 540)}, [boxes("a", rng, SIZE)])
    assert check.id == "boxes-end-beyond"


def test_a_single_camera_is_reported_where_both_borders_agree() -> None:
    rng = np.random.default_rng(4)
    assert warning({"a": SIZE}, [boxes("a", rng, (1280, 720), (1280, 720))]) is not None


def test_an_object_that_does_not_move_is_no_border() -> None:
    still = boxes("a", np.random.default_rng(4), SIZE)
    same = {
        name: np.full(len(still), value)
        for name, value in zip(
            ("left_px", "top_px", "width_px", "height_px"), (1200.0, 600.0, 79.0, 119.0), strict=True
        )
    }
    assert warning({"a": SIZE}, [replace(still, **same)]) is None


def test_a_hundred_rigs_of_the_stated_size_are_not_stated() -> None:
    """Boxes that end at the border, that go over it, and of people who do not come near it."""
    for seed in range(100):
        rng = np.random.default_rng(seed)
        kinds: list[tuple[tuple[int, int], tuple[int, int] | None]] = [(SIZE, SIZE), (SIZE, None), ((1500, 800), None)]
        tables = [boxes(name, rng, *kinds[(seed + n) % 3]) for n, name in enumerate("abc")]
        assert warning(dict.fromkeys("abc", SIZE), tables) is None
        still = [boxes(name, rng, (1300, 700), None) for name in "abc"]
        assert warning(dict.fromkeys("abc", SIZE), still) is None


TOML = """[{name}]
size = [1920, 1080]
matrix = [[1350.0, 0.0, 960.0], [0.0, 1350.0, 540.0], [0.0, 0.0, 1.0]]
rotation = [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]
translation = [{x}, 2.0, 0.0]
"""


def ingest(folder: Path, *more: str) -> ExitCode:
    (folder / "c.toml").write_text("".join(TOML.format(name=name, x=x) for name, x in (("a", 0.0), ("b", 1.0))))
    lines = [f"{k},{name},100,200,140,300" for k in range(3) for name in "ab"]
    (folder / "boxes.csv").write_text("\n".join(["frame,camera,left,top,right,bottom", *lines]) + "\n")
    command = ["ingest", "-o", str(folder / "r.mcap"), "--calibration", str(folder / "c.toml"), "--fps", "10"]
    return ExitCode(run([*command, "--overwrite", "--boxes", str(folder / "boxes.csv"), *more]))


def test_a_size_that_is_given_scales_a_calibration_of_another(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert ingest(tmp_path, "--image-size", "1280x720") == ExitCode.DONE
    assert "camera a: frames of 1280 x 720 px, calibrated for 1920 x 1080: assumed to be scaled by 0.6667" in (
        capsys.readouterr().err
    )
    scene = open_recording(tmp_path / "r.mcap").scene
    assert scene is not None
    assert all(c.image_size == (1280, 720) and c.focal_px == pytest.approx([900, 900]) for c in scene.cameras)
    assert ingest(tmp_path, "--image-size", "1920x1080") == ExitCode.DONE
    assert ingest(tmp_path, "--image-size", "640x480") == ExitCode.BAD_INPUT
    assert "differ in aspect ratio" in capsys.readouterr().err


def fisheye_box(angle: float, side: Floats) -> str:
    """left, top, right, bottom of a small box in the direction of `side`, this many degrees off the axis."""
    u, v = np.array([640.0, 360.0]) + 420.0 * np.radians(angle) * side
    return f"{u - 2:.2f},{v - 4:.2f},{u + 2:.2f},{v + 4:.2f}"


def test_boxes_beyond_80_degrees_of_a_fisheye_are_lost_and_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = TOML.format(name="a", x=0.0).replace("1350.0", "420.0").replace("960.0", "640.0").replace("540.0", "360.0")
    text = text.replace("[1920, 1080]", "[1280, 720]") + "fisheye = true\ndistortions = [0.0, 0.0, 0.0, 0.0]\n"
    (tmp_path / "c.toml").write_text(text)
    rows = [(0, 30.0), (0, 79.0), (1, 82.0), (2, 81.0), (2, 10.0)]
    lines = [f"{frame},a,{fisheye_box(angle, np.array([1.0, 0.0]))}" for frame, angle in rows]
    (tmp_path / "boxes.csv").write_text("\n".join(["frame,camera,left,top,right,bottom", *lines]) + "\n")
    command = ["ingest", "-o", str(tmp_path / "r.mcap"), "--calibration", str(tmp_path / "c.toml"), "--fps", "10"]
    assert run([*command, "--boxes", str(tmp_path / "boxes.csv")]) == ExitCode.LOSSY
    stderr = capsys.readouterr().err
    assert "more than 80 degrees off the axis of a fisheye lens (2 lost)" in stderr
    table = open_recording(tmp_path / "r.mcap").read(Boxes)
    assert [int(((table.frame == k) & (table.box >= 0)).sum()) for k in range(3)] == [2, 0, 1]
    assert sorted(set(table.frame.tolist())) == [0, 1, 2]  # a frame without the box is one without a detection


def test_boxes_of_larger_images_are_lost_in_the_order_of_time_and_the_size_is_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Frames that lose their only box stand between frames that keep theirs."""
    (tmp_path / "c.toml").write_text(TOML.format(name="a", x=0.0))
    lines = [f"{k},a,{100 + 2500 * (k % 2)},200,{140 + 2500 * (k % 2)},300" for k in range(40)]
    (tmp_path / "boxes.csv").write_text("\n".join(["frame,camera,left,top,right,bottom", *lines]) + "\n")
    command = ["ingest", "-o", str(tmp_path / "r.mcap"), "--calibration", str(tmp_path / "c.toml"), "--fps", "10"]
    assert run([*command, "--boxes", str(tmp_path / "boxes.csv")]) == ExitCode.LOSSY
    stderr = capsys.readouterr().err
    assert "wholly outside the image of 1920 x 1080 px (20 lost)" in stderr
    assert "warning: camera a: 50% of its boxes end beyond its images" in stderr
    table = open_recording(tmp_path / "r.mcap").read(Boxes)
    assert table.frame.tolist() == list(range(40))
    assert (table.box >= 0).tolist() == [k % 2 == 0 for k in range(40)]


def test_two_cameras_with_the_same_boxes_are_named() -> None:
    rng = np.random.default_rng(4)
    one, other = boxes("a", rng, SIZE), boxes("c", rng, SIZE)
    copy = replace(one, sensor=np.full(len(one), "b"))
    (check,) = found({}, [one, copy, other])
    assert (check.id, check.sensors, check.figures["share"]) == ("boxes-identical", ("a", "b"), 1.0)
