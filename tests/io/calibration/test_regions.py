"""Calibrations of a part of the sensor: binning and regions of ROS (REP 104), crops and rows of Qualisys."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from occlog.errors import InputError
from occlog.io.formats.calibration.common import CalibrationOptions
from occlog.io.formats.calibration.reader import CalibrationFile, read_calibration

POINTS = np.array([[0.3, -0.2, 5.0], [-0.6, 0.4, 6.0], [0.1, 0.7, 4.0]])
MATRIX = [900.0, 0.0, 640.0, 0.0, 905.0, 360.0, 0.0, 0.0, 1.0]
TEXT = """<calibration><cameras><camera active="1" serial="a" viewrotation="0"{more}>
<fov_video left="{left}" top="{top}" right="{right}" bottom="{bottom}"/>
<fov_video_max left="0" top="0" right="1919" bottom="{last}"/>
<transform r11="1" r12="0" r13="0" r21="0" r22="1" r23="0" r31="0" r32="0" r33="1" x="0" y="0" z="0"/>
<intrinsic centerPointU="61440" centerPointV="34816" focalLengthU="107599" focalLengthV="107588"/>
</camera></cameras></calibration>"""


def ros(folder: Path, message: bool, **values: object) -> CalibrationFile:
    """A `camera_info` of 1280 x 720 px, as `camera_calibration` writes it, or as a message of ROS."""
    lens = {"rows": 1, "cols": 5, "data": [-0.2, 0.05, 0.001, -0.002, 0.0]}
    info: dict[str, object] = {"distortion_model": "plumb_bob", **values}
    if message:
        info |= {
            "header": {"frame_id": "a_optical_frame"},
            "width": 1280,
            "height": 720,
            "K": MATRIX,
            "D": lens["data"],
        }
    else:
        info |= {"camera_name": "a", "image_width": 1280, "image_height": 720, "distortion_coefficients": lens}
        info["camera_matrix"] = {"rows": 3, "cols": 3, "data": MATRIX}
    none = {"translation": [0.0, 0.0, 0.0], "rotation": [0.0, 0.0, 0.0, 1.0]}
    (folder / "a.yaml").write_text(yaml.safe_dump(info))
    (folder / "tf.yaml").write_text(yaml.safe_dump([{"frame_id": "map", "child_frame_id": "a_optical_frame", **none}]))
    return read_calibration([folder / "a.yaml", folder / "tf.yaml"])


@pytest.mark.parametrize("message", [False, True])
@pytest.mark.parametrize(
    ("binning", "roi", "size"),
    [
        ((2, 2), (0, 0, 0, 0), (640, 360)),
        ((0, 0), (200, 100, 640, 360), (640, 360)),
        ((2, 4), (200, 100, 640, 360), (320, 90)),
        ((1, 1), (0, 0, 1280, 720), (1280, 720)),
        ((1, 1), (80, 40, 0, 0), (1200, 680)),
    ],
)
def test_binning_and_region_of_ros_scale_and_shift_the_pixels(
    tmp_path: Path, message: bool, binning: tuple[int, int], roi: tuple[int, int, int, int], size: tuple[int, int]
) -> None:
    """A pixel of the image covers `binning` pixels of the sensor, from the region's first one on."""
    (whole,) = ros(tmp_path, message).cameras
    keys = dict(zip(("x_offset", "y_offset", "width", "height"), roi, strict=True))
    found = ros(tmp_path, message, binning_x=binning[0], binning_y=binning[1], roi={**keys, "do_rectify": False})
    (camera,) = found.cameras
    bins = np.maximum(binning, 1)
    assert camera.image_size == size
    wanted = (whole.project(POINTS) - roi[:2] + 0.5) / bins - 0.5
    np.testing.assert_allclose(camera.project(POINTS), wanted, atol=1e-9)
    assert any("of a sensor of 1280 x 720" in note for note in found.notes) == (size != (1280, 720))
    # Also of unequal binning in x and y
    assert "focal-lengths-differ" not in {check.id for check in found.checks}


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"roi": {"x_offset": 1000, "width": 640}}, "do not fit a sensor of 1280 x 720 px"),
        ({"binning_x": -2}, "do not fit a sensor of 1280 x 720 px"),
        ({"binning_x": 2.5}, "binning_x '2.5'; a whole number was expected"),
        ({"roi": [1, 2]}, "x_offset, y_offset, width and height were expected"),
    ],
)
def test_regions_that_cannot_be_are_refused(tmp_path: Path, values: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        ros(tmp_path, False, **values)


def qualisys(folder: Path, last: int, more: str, **limits: int) -> CalibrationFile:
    (folder / "a.qca.txt").write_text(TEXT.format(more=more, last=last, **limits))
    return read_calibration([folder / "a.qca.txt"])


@pytest.mark.parametrize(
    ("last", "more", "limits", "size", "scale"),
    [
        (1087, "", (0, 0, 1919, 1087), (1920, 1088), 1.0),
        (1087, ' video_resolution="1080p"', (0, 0, 1919, 1087), (1920, 1088), 1.0),
        (1087, ' video_resolution="540p"', (0, 0, 1919, 1087), (960, 544), 0.5),
        (1079, ' video_resolution="720p"', (0, 0, 1919, 1079), (1280, 720), 2 / 3),
        (1439, ' video_resolution="1440p"', (240, 0, 1679, 1439), (1440, 1440), 1.0),
        (1087, ' video_resolution="N/A"', (100, 50, 1099, 849), (1000, 800), 1.0),
        (1087, ' video_resolution="540p"', (100, 50, 1099, 849), (500, 400), 0.5),
    ],
)
def test_video_of_qualisys_is_the_stated_part_of_the_sensor_at_the_stated_rows(
    tmp_path: Path, last: int, more: str, limits: tuple[int, ...], size: tuple[int, int], scale: float
) -> None:
    whole = qualisys(tmp_path, last, "", left=0, top=0, right=1919, bottom=last).cameras[0]
    found = qualisys(tmp_path, last, more, **dict(zip(("left", "top", "right", "bottom"), limits, strict=True)))
    (camera,) = found.cameras
    assert camera.image_size == size
    points = POINTS @ whole.rotation.T
    wanted = (whole.project(points) - limits[:2] + 0.5) * scale - 0.5
    np.testing.assert_allclose(camera.project(points), wanted, atol=1e-9)
    assert any("video_resolution" in note for note in found.notes) == (scale != 1.0 or limits[0] > 0)


def test_rows_that_a_sensor_does_not_have_are_refused(tmp_path: Path) -> None:
    for stated in ("2160p", "full", "0p"):
        with pytest.raises(InputError, match=f"video_resolution {stated}; 540p or the like"):
            qualisys(tmp_path, 1087, f' video_resolution="{stated}"', left=0, top=0, right=1919, bottom=1087)


def test_clocks_of_kalibr_that_differ_are_noted_with_the_option(tmp_path: Path) -> None:
    chain = {
        f"cam{n}": {
            "camera_model": "pinhole",
            "distortion_model": "none",
            "intrinsics": [900.0, 905.0, 640.0, 360.0],
            "resolution": [1280, 720],
            "timeshift_cam_imu": 0.01 * n,
            **({"T_cn_cnm1": np.eye(4).tolist()} if n else {}),
        }
        for n in (0, 1)
    }
    (tmp_path / "camchain.yaml").write_text(yaml.safe_dump(chain))
    (found,) = (c for c in read_calibration([tmp_path / "camchain.yaml"]).checks if c.id == "time-shifts-unused")
    assert found.text.endswith("cam1=0.01s")


def test_images_of_caliscope_that_are_turned_are_noted(tmp_path: Path) -> None:
    text = "[cam1]\nsize = [640, 480]\nmatrix = [[500.0, 0, 320], [0, 510.0, 240], [0, 0, 1]]\nrotation = [1.2, 0, 0]\n"
    (tmp_path / "a.toml").write_text(f"{text}translation = [0.0, 0.0, 3.0]\nrotation_count = 1\n")
    (found,) = read_calibration([tmp_path / "a.toml"], options=CalibrationOptions("m")).checks
    assert (found.id, found.status, found.sensors) == ("images-before-rotation", "failed", ("cam1",))


def matrix_of(tmp_path: Path, size: tuple[int, int], focal: float, x: float, y: float) -> Path:
    text = f"[cam1]\nsize = {list(size)}\nmatrix = [[{focal}, 0, {x}], [0, {focal}, {y}], [0, 0, 1]]\n"
    (tmp_path / "a.toml").write_text(f"{text}rotation = [1.2, 0, 0]\ntranslation = [0.0, 0.0, 3.0]\n")
    return tmp_path / "a.toml"


@pytest.mark.parametrize(
    ("size", "middle", "expected"),
    [
        ((1280, 720), (640.0, 355.0), ""),
        ((1280, 720), (540.0, 300.0), ""),
        ((1920, 1080), (640.0, 355.0), "(factor 0.663)"),
        ((640, 360), (640.0, 355.0), "(factor 1.99)"),
        ((720, 1280), (640.0, 355.0), "(width and height exchanged)"),
        ((1280, 720), (0.0, 0.0), "the middle of images of 1 x 1 px"),
    ],
)
def test_a_matrix_of_images_of_another_size_than_stated_is_reported(
    tmp_path: Path, size: tuple[int, int], middle: tuple[float, float], expected: str
) -> None:
    (found,) = read_calibration([matrix_of(tmp_path, size, 900.0, *middle)]).checks
    assert found.id == ("principal-point-off" if expected else "")
    assert expected in found.text


@pytest.mark.parametrize(
    ("aspect", "reported"), [(1.0, ""), (1.46, ""), (0.75, ""), (2.0, "900 and 1800 px"), (0.5, "900 and 450 px")]
)
def test_pixels_that_are_far_from_square_are_stated(tmp_path: Path, aspect: float, reported: str) -> None:
    path = matrix_of(tmp_path, (1280, 720), 900.0, 640.0, 355.0)
    path.write_text(path.read_text().replace("[0, 900.0, 355.0]", f"[0, {900.0 * aspect}, 355.0]"))
    (found,) = read_calibration([path]).checks
    assert found.id == ("focal-lengths-differ" if reported else "")
    assert reported in found.text


@pytest.mark.parametrize(
    ("k1", "focal", "width", "expected"),
    [
        (-0.2, 920.0, 1280, 1),
        (-0.2, 1100.0, 1280, 0),
        (-0.2, 920.0, 1300, 0),
        (-0.015, 920.0, 1280, 0),
        (0.0, 900.0, 1280, 0),
    ],
)
def test_a_lens_without_distortion_beside_one_of_the_same_type_with_some_is_named(
    tmp_path: Path, k1: float, focal: float, width: int, expected: int
) -> None:
    path = matrix_of(tmp_path, (1280, 720), 900.0, 640.0, 355.0)
    other = path.read_text().replace("cam1", "cam2").replace("900.0", f"{focal}").replace("1280", f"{width}")
    other = other.replace("640", f"{width // 2}").replace("[0.0, 0.0, 3.0]", "[1.0, 0.0, 3.0]")
    path.write_text(f"{path.read_text()}{other}distortions = [{k1}, 0, 0, 0, 0]\n")
    found = [check for check in read_calibration([path]).checks if check.found]
    assert [(each.id, each.sensors) for each in found] == expected * [("distortion-missing", ("cam1",))]
    # 640 px beside the middle, 0.2 of the square of 640 / 920 less
    assert all(each.figures["offset_px"] == pytest.approx(0.2 * 640.0**3 / 920.0**2, rel=1e-5) for each in found)


@pytest.mark.parametrize("focal", [1.0, 4.2, 50.0])
def test_a_matrix_that_is_not_in_pixels_is_refused(tmp_path: Path, focal: float) -> None:
    with pytest.raises(InputError, match="give the matrix in pixels, not normalised or in mm"):
        read_calibration([matrix_of(tmp_path, (1280, 720), focal, 640.0, 360.0)])


def test_a_transposed_projection_matrix_is_named(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "a.txt", np.arange(12.0).reshape(4, 3))
    with pytest.raises(InputError, match=r"\(4, 3\) numbers; .*transpose it"):
        read_calibration([tmp_path / "a.txt"], options=CalibrationOptions("m", (640, 480)))
