"""Videos that were cut or damaged: the frames that are left keep their numbers, the rest is listed."""

from __future__ import annotations

import struct
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from video_samples import FRAMES, KINDS, avi, faststart, fragmented, jpeg, number_shown, write_video

from occlog.errors import InputError
from occlog.io.frames.codec import size_changes
from occlog.io.frames.decode import decode, examine
from occlog.io.frames.decoders.process import start_decoder
from occlog.records.losses import Loss

HALF = FRAMES // 2


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("videos")
    return {name: write_video(folder / name).read_bytes() for name in KINDS}


def decoded(path: Path, start: int = 0, stop: int | None = None) -> tuple[list[int], list[int], list[Loss]]:
    """Numbers given to the frames, numbers shown by them, and what was lost."""
    losses: list[Loss] = []
    found = decode(examine(path), start, stop, losses.append, sizes=size_changes(path))
    pictures = [(p.index, number_shown(p.image)) for p in found]
    return [i for i, _ in pictures], [n for _, n in pictures], losses


def check(path: Path, data: bytes, *, blurred: int = 0) -> tuple[list[int], list[Loss]]:
    """Every delivered frame shows its number (but for `blurred` concealed ones), every other one is counted as lost."""
    path.write_bytes(data)
    given, shown, losses = decoded(path)
    assert sum(g != s for g, s in zip(given, shown, strict=True)) <= blurred
    assert sum(loss.count for loss in losses if "position in" not in loss.what) == FRAMES - len(given)
    assert all(a < b for a, b in pairwise(given))
    return given, losses


@pytest.mark.parametrize("name", KINDS)
def test_a_whole_video_loses_nothing(whole: dict[str, bytes], tmp_path: Path, name: str) -> None:
    given, losses = check(tmp_path / name, whole[name])
    assert given == list(range(FRAMES))
    assert losses == []


@pytest.mark.parametrize("share", [0.3, 0.5, 0.77, 0.95, 0.99])
@pytest.mark.parametrize("name", [n for n in KINDS if not n.endswith(".mp4")])
def test_a_cut_video_ends_where_its_bytes_end(whole: dict[str, bytes], tmp_path: Path, name: str, share: float) -> None:
    data = whole[name]
    start = data.index(b"movi" if name.endswith(".avi") else b"\x1f\x43\xb6\x75")
    given, losses = check(tmp_path / name, data[: start + int((len(data) - start) * share)])
    assert given == list(range(len(given)))
    assert abs(len(given) - share * FRAMES) <= 0.2 * FRAMES
    assert losses
    assert "cut" in losses[0].what
    if len(given) < FRAMES:
        assert losses[-1].place.startswith("frame")


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
@pytest.mark.parametrize("arrange", [faststart, fragmented])
def test_a_cut_mp4_with_its_index_ahead(
    whole: dict[str, bytes], tmp_path: Path, arrange: Callable[[bytes], bytes], share: float
) -> None:
    data = arrange(whole["mjpg.mp4"])
    start = data.index(b"mdat")
    path = tmp_path / "v.mp4"
    path.write_bytes(data[: start + int((len(data) - start) * share)])
    given, shown, losses = decoded(path)
    assert given == shown == list(range(len(given)))
    assert losses
    assert abs(len(given) - share * FRAMES) <= 3
    # A fragmented file announces only the frames of the fragments that have begun.
    announced = len(given) + sum(loss.count for loss in losses)
    assert announced == FRAMES if arrange is faststart else announced % 10 == 0


@pytest.mark.parametrize("share", [0.1, 0.6, 0.97])
def test_a_cut_mp4_without_index_is_one_clear_error(whole: dict[str, bytes], tmp_path: Path, share: float) -> None:
    data = whole["mp4v.mp4"]
    path = tmp_path / "v.mp4"
    path.write_bytes(data[: int(len(data) * share)])
    with pytest.raises(InputError, match=r"v\.mp4: the video cannot be opened.*moov.*is missing") as caught:
        examine(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", KINDS)
def test_a_wiped_stretch_in_the_middle_is_noticed(whole: dict[str, bytes], tmp_path: Path, name: str) -> None:
    data = bytearray(whole[name])
    start = int(len(data) * 0.4)
    data[start : start + len(data) // 20] = bytes(len(data) // 20)
    # Codecs that build on earlier frames go on with concealed pictures until the next key frame.
    given, _ = check(tmp_path / name, bytes(data), blurred=2 if "mjpg" in name else FRAMES // 2)
    assert given[0] == 0
    assert given[-1] == FRAMES - 1
    with decoder(tmp_path / name) as running:
        assert [frame.index for frame in running.delivered()] == given
    assert running.losses


def decoder(path: Path, **more: object):
    job = {"kind": "video", "path": str(path), "start": 0, "stop": None, "store": "none", "quality": 95, **more}
    return start_decoder(job)


@pytest.mark.parametrize("name", ["ffv1.mkv", "ffv1.avi", "ffv1.mp4", "mjpg.mkv", "mp4v.mkv"])
def test_a_single_changed_byte_is_noticed_where_there_are_check_sums(
    whole: dict[str, bytes], tmp_path: Path, name: str
) -> None:
    data = bytearray(whole[name])
    data[len(data) // 2] ^= 0x10
    (tmp_path / name).write_bytes(bytes(data))
    with decoder(tmp_path / name) as running:
        assert FRAMES - 1 <= len(list(running.delivered())) <= FRAMES
    assert running.losses
    assert "0x" not in str(running.losses)  # addresses differ from run to run


@pytest.mark.parametrize("name", ["mjpg.avi", "ffv1.avi", "mjpg.mkv", "ffv1.mkv"])
def test_missing_bytes_in_the_middle(whole: dict[str, bytes], tmp_path: Path, name: str) -> None:
    data = bytearray(whole[name])
    del data[len(data) // 2 : len(data) // 2 + 100]
    given, losses = check(tmp_path / name, bytes(data), blurred=1)
    assert losses
    assert len(given) >= HALF - 2


def test_behind_damage_in_an_avi_the_index_gives_the_numbers(tmp_path: Path) -> None:
    data = bytearray(avi([jpeg(k) for k in range(FRAMES)]))
    tenth = data.index(b"00dc", data.index(b"movi"))
    for _ in range(10):
        (size,) = struct.unpack_from("<I", data, tenth + 4)
        tenth += 8 + size + (size & 1)
    data[tenth : tenth + 8] = b"\xff" * 8
    given, losses = check(tmp_path / "v.avi", bytes(data))
    assert given == [k for k in range(FRAMES) if k != 10]
    assert [loss.count for loss in losses if loss.count] == [1]


def test_frames_dropped_by_the_recorder_are_no_loss(tmp_path: Path) -> None:
    path = tmp_path / "v.avi"
    path.write_bytes(avi([jpeg(k) if k % 5 else b"" for k in range(FRAMES)]))
    given, shown, losses = decoded(path)
    assert shown == [k for k in range(FRAMES) if k % 5]
    assert given == list(range(len(shown)))
    assert losses == []


def test_frames_of_another_size_are_left_out_and_counted(tmp_path: Path) -> None:
    path = tmp_path / "v.avi"
    path.write_bytes(avi([jpeg(k, (80, 60) if 12 <= k < 15 else (160, 120)) for k in range(FRAMES)]))
    given, shown, losses = decoded(path)
    assert given == shown == [k for k in range(FRAMES) if not 12 <= k < 15]
    assert [(loss.place, loss.count) for loss in losses] == [("frames 12-14", 3)]
    assert "80 x 60 px where 160 x 120 was expected" in losses[0].what


def test_a_range_of_frames_is_read_and_checked_alone(whole: dict[str, bytes], tmp_path: Path) -> None:
    path = tmp_path / "mjpg.mkv"
    path.write_bytes(whole["mjpg.mkv"][: int(len(whole["mjpg.mkv"]) * 0.8)])
    given, shown, losses = decoded(path, 5, 20)
    assert given == shown == list(range(5, 20))
    assert losses == []
    given, _, losses = decoded(path, 20, FRAMES)
    assert given[0] == 20
    assert sum(loss.count for loss in losses) == 20 - len(given)
    with pytest.raises(InputError, match="has only 40"):
        decoded(path, 100, 200)


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("empty.mp4", b"", "is empty"),
        ("text.mp4", b"frame,camera\n1,2\n" * 50, "not a video file that FFmpeg can read"),
        ("noise.avi", bytes(np.random.default_rng(1).integers(0, 256, 5000, dtype=np.uint8)), "not a video file"),
        ("head.mkv", b"\x1a\x45\xdf\xa3" + bytes(3000), "cannot be opened"),
        (
            "page.mp4",
            b"<!DOCTYPE html>\n<html><title>Sign in</title></html>\n",
            "is a web page.*download the file itself",
        ),
        ("pointer.mkv", b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "Git LFS.*git lfs pull"),
        ("list.mp4", b"#EXTM3U\n#EXTINF:1\n/etc/passwd\n", "not a video file"),
    ],
)
def test_what_is_no_video_is_one_clear_line(tmp_path: Path, name: str, data: bytes, message: str) -> None:
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(InputError, match=message) as caught:
        examine(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_files_and_folders_are_distinguished(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        examine(tmp_path / "none.mp4")
    with pytest.raises(InputError, match="is a folder"):
        examine(tmp_path)


def test_a_wrong_extension_does_not_matter(whole: dict[str, bytes], tmp_path: Path) -> None:
    given, losses = check(tmp_path / "really_matroska.mp4", whole["mjpg.mkv"])
    assert given == list(range(FRAMES))
    assert losses == []


def test_a_frame_too_large_is_refused_before_it_is_decoded(tmp_path: Path) -> None:
    data = bytearray(avi([jpeg(0)]))
    image = data.index(b"\xff\xc0")
    struct.pack_into(">HH", data, image + 5, 60000, 60000)
    path = tmp_path / "v.avi"
    path.write_bytes(bytes(data))
    with pytest.raises(InputError, match=r"v\.avi"):
        examine(path)


def test_the_hidden_part_of_an_edit_list_is_no_loss(whole: dict[str, bytes], tmp_path: Path) -> None:
    data = bytearray(whole["mjpg.mp4"])
    scale = struct.unpack_from(">I", data, data.index(b"mdhd") + 16)[0]
    struct.pack_into(">II", data, data.index(b"elst") + 12, 1000, scale // 2)
    path = tmp_path / "v.mp4"
    path.write_bytes(bytes(data))
    given, shown, losses = decoded(path)
    assert shown == list(range(10, 30))
    assert given == list(range(20))
    assert losses == []
