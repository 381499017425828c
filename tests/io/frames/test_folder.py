"""Image folders: order, numbers and times of the files."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from occlog.errors import InputError, UsageError
from occlog.io.files.names import match_sensor, means_none, natural_sorted, safe_name
from occlog.io.formats.boxes.datasets import frame_files, label_files
from occlog.io.frames.codec import dark_bars, decode_image, encode_image, image_damage, image_size
from occlog.io.frames.streams import read_folders
from occlog.io.messages.bag import is_bag

RATE = {"a": Fraction(10), "b": Fraction(10)}


def folder(tmp_path: Path, name: str, *files: str) -> Path:
    path = tmp_path / name
    path.mkdir()
    for file in (*files, "notes.txt"):
        (path / file).write_bytes(b"x")
    return path


def test_numbered_images_of_two_cameras_count_from_the_same_number(tmp_path: Path) -> None:
    a = folder(tmp_path, "a", "img10.png", "img9.png", "img2.jpg")
    b = folder(tmp_path, "b", "f_0004.PNG", "f_0003.PNG")
    found = read_folders({"a": a, "b": b}, {}, RATE, {"b": 7}, None)
    assert [(i, p.name) for i, p in found["a"].files] == [(0, "img2.jpg"), (7, "img9.png"), (8, "img10.png")]
    assert [i for i, _ in found["b"].files] == [1, 2]
    assert found["a"].times.at(np.array([8])).tolist() == [800_000_000]
    assert found["b"].times.at(np.array([1])).tolist() == [100_000_007]
    assert found["a"].times.source == "frame rate 10 fps (given; 2 is frame 0)"
    assert read_folders({"a": a}, {}, RATE, {}, 1)["a"].files[0][0] == 1


def test_files_that_a_system_adds_are_no_frames(tmp_path: Path) -> None:
    """macOS writes `._NAME` for each file on other disks, Windows `Thumbs.db`."""
    path = folder(
        tmp_path, "a", "._f_1.png", "._f_2.png", ".DS_Store", "Thumbs.db", "desktop.ini", "f_1.png", "f_2.png"
    )
    assert [(i, p.name) for i, p in read_folders({"a": path}, {}, RATE, {})["a"].files] == [
        (0, "f_1.png"),
        (1, "f_2.png"),
    ]
    labels = folder(tmp_path, "labels", "._f_1.txt", "f_1.txt", "._f_1.json", "f_2.json")
    assert [p.name for p in label_files(labels)] == ["f_1.txt"]
    assert {n: p.name for n, p in frame_files(labels).items()} == {2: "f_2.json"}
    assert not is_bag(folder(tmp_path, "bag", "._walk_0.db3"))


def test_names_that_are_times(tmp_path: Path) -> None:
    path = folder(tmp_path, "a", "1700000000123456789.png", "1700000000223456789.png")
    found = read_folders({"a": path}, {}, {}, {})["a"]
    assert found.times.at(np.array([0, 1])).tolist() == [1700000000123456789, 1700000000223456789]
    assert found.times.source == "file names (ns)"


def test_a_sidecar_gives_one_time_an_image(tmp_path: Path) -> None:
    path = folder(tmp_path, "a", "x.png", "y.png")
    found = read_folders({"a": path}, {"a": (np.array([5, 9]), "ts.csv")}, {}, {})["a"]
    assert found.times.at(np.array([1])).tolist() == [9]
    with pytest.raises(InputError, match=r"2 images, but ts\.csv has 3 times"):
        read_folders({"a": path}, {"a": (np.array([5, 9, 11]), "ts.csv")}, {}, {})


def test_faults_of_folders(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        read_folders({"a": tmp_path / "none"}, {}, RATE, {})
    with pytest.raises(InputError, match="holds no image"):
        read_folders({"a": folder(tmp_path, "empty")}, {}, RATE, {})
    with pytest.raises(InputError, match="is a file; a folder of images"):
        read_folders({"a": tmp_path / "empty" / "notes.txt"}, {}, RATE, {})
    path = folder(tmp_path, "a", "one.png")
    with pytest.raises(InputError, match="has no number in its name"):
        read_folders({"a": path}, {}, RATE, {})
    path = folder(tmp_path, "b", "a1.png", "b1.png")
    with pytest.raises(InputError, match="number 1 does not come after 1"):
        read_folders({"a": path}, {}, RATE, {})
    path = folder(tmp_path, "c", "1.png")
    with pytest.raises(UsageError, match="give the frame rate"):
        read_folders({"c": path}, {}, {}, {})
    with pytest.raises(InputError, match="is before --first-number 5"):
        read_folders({"a": path}, {}, RATE, {}, 5)


@pytest.mark.parametrize("name", ["1714562400123", "1714562400123456", "9" * 19, "9" * 60])
def test_times_in_other_units_than_ns_are_no_numbers_of_frames(tmp_path: Path, name: str) -> None:
    """Times in ms were counted as frames, and 19 digits were too many for 64 bits."""
    place = folder(tmp_path, "a", f"{name}.png")
    with pytest.raises(InputError, match=r"a time in ms or us|out of range"):
        read_folders({"a": place}, {}, {"a": Fraction(25)}, {})


def test_names_sort_as_people_expect() -> None:
    names = ["cam10", "cam2", "cam02", "Cam1", "a", "2", "cam2b"]
    assert natural_sorted(names) == natural_sorted(reversed(names))
    assert natural_sorted(["f²", "f1", "f٣", "f2"]) == ["f1", "f2", "f٣", "f²"]
    assert natural_sorted(["f10.png", "f9.png", "f009.png"]) == ["f009.png", "f9.png", "f10.png"]


def test_names_of_sensors_match_by_their_last_number() -> None:
    assert match_sensor("2", ["cam_1", "cam_2"], "x") == "cam_2"
    assert match_sensor("cam02", ["cam1", "cam2"], "x") == "cam2"
    assert match_sensor("left", ["left", "right"], "x") == "left"
    assert match_sensor("LEFT", ["Left", "Right"], "x") == "Left"
    assert not means_none("LEFT", ["Left", "Right"])
    assert means_none("LEFT", ["Right", "Back"])
    with pytest.raises(InputError, match="x: camera '3' is none of cam1, cam2"):
        match_sensor("3", ["cam1", "cam2"], "x")
    with pytest.raises(InputError, match="may be any of a1, b1"):
        match_sensor("1", ["a1", "b1"], "x")
    assert safe_name(" my cam/1=x ") == "my_cam_1_x"


@pytest.mark.parametrize("kind", ["png", "jpeg"])
def test_images_survive_coding_and_damage_is_seen(kind: str) -> None:
    image = np.random.default_rng(0).integers(0, 255, (40, 60, 3), dtype=np.uint8)
    data = encode_image(image, kind, 95)
    assert image_size(data) == (60, 40)
    assert image_damage(data) is None
    back = decode_image(data, "x")
    assert back.shape == image.shape
    if kind == "png":
        assert np.array_equal(back, image)
    for cut in (10, 100, len(data) // 2, len(data) - 3):
        with pytest.raises(InputError, match=r"^x: "):
            decode_image(data[:cut], "x")
    with pytest.raises(InputError, match="not an image"):
        decode_image(b"", "x")


def test_bars_of_a_dark_image_are_none() -> None:
    assert dark_bars(np.zeros((20, 30, 3), np.uint8)) == (0, 0, 0, 0)
    image = np.full((20, 30), 90, np.uint8)
    image[:, :4] = 3
    assert dark_bars(image) == (4, 0, 0, 0)
