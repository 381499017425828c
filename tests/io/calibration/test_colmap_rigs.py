"""A model of COLMAP with several images of cameras that stand still, and of one that moves."""

from __future__ import annotations

from pathlib import Path

import folders as make
import pytest
from people_boxes import hall

from occlog.errors import InputError
from occlog.io.formats.calibration.common import CalibrationOptions
from occlog.io.formats.calibration.reader import read_calibration


def doubled(folder: Path, moved: float) -> Path:
    """Two images a camera, in its folder; the second ones are moved [m]."""
    make.colmap(folder, hall("abc"))
    path = folder / "images.txt"
    lines = []
    for line in (text for text in path.read_text().splitlines() if text and text[0] != "#"):
        cells = line.split()
        name = cells[9].removesuffix(".jpg")
        lines += [" ".join([*cells[:9], f"{name}/0001.jpg"]), ""]
        cells[5] = str(float(cells[5]) + moved)
        lines += [" ".join([*cells[:9], f"{name}/0002.jpg"]), ""]
    path.write_text("\n".join(lines) + "\n")
    return folder


def test_images_of_cameras_that_stand_still_count_once(tmp_path: Path) -> None:
    found = read_calibration([doubled(tmp_path, 0.02)], "auto", CalibrationOptions("m"))
    assert [c.name for c in found.cameras] == ["a", "b", "c"]
    for camera, true in zip(found.cameras, hall("abc").cameras, strict=True):
        assert camera.position == pytest.approx(true.position, abs=1e-6)
    assert "6 images of 3 cameras that stand still; the first of each counts" in found.notes


def test_a_camera_that_moves_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"two images of camera 'a' have poses 0.5 m and 0.00 deg apart"):
        read_calibration([doubled(tmp_path, 0.5)], "auto", CalibrationOptions("m"))
