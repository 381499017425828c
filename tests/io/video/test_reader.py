"""What the container parsers find in whole, unusual and mutilated files."""

from __future__ import annotations

import struct
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from video_samples import FRAMES, KINDS, avi, faststart, fragmented, jpeg, write_video

from occlog.errors import InputError
from occlog.io.frames.streams import video_times
from occlog.io.video.container import Container
from occlog.io.video.reader import read_container

STEP = 50_000_000


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("videos")
    return {name: write_video(folder / name) for name in KINDS}


def of(path: Path, data: bytes) -> Container | None:
    path.write_bytes(data)
    return read_container(path)


@pytest.mark.parametrize("name", KINDS)
def test_every_frame_of_a_whole_file_is_found_at_its_time(whole: dict[str, Path], name: str) -> None:
    found = read_container(whole[name])
    assert found is not None
    assert found.problems == ()
    assert found.pts_ns is not None
    assert found.pts_ns.tolist() == [STEP * k for k in range(FRAMES)]
    assert not found.broken.any()
    assert found.rate == Fraction(20)
    assert found.stamped == (not name.endswith(".avi"))


def test_an_index_before_the_pictures_is_read(whole: dict[str, Path], tmp_path: Path) -> None:
    found = of(tmp_path / "v.mp4", faststart(whole["mjpg.mp4"].read_bytes()))
    assert found is not None
    assert found.frames == FRAMES
    assert not found.broken.any()
    assert found.problems == ()


def test_samples_beyond_the_end_of_a_cut_file_are_counted(whole: dict[str, Path], tmp_path: Path) -> None:
    data = faststart(whole["mjpg.mp4"].read_bytes())
    half = data[: data.index(b"mdat") + (len(data) - data.index(b"mdat")) // 2]
    found = of(tmp_path / "v.mp4", half)
    assert found is not None
    assert found.frames == FRAMES
    lost = int(found.broken.sum())
    assert FRAMES // 2 - 3 <= lost <= FRAMES // 2 + 3
    assert found.broken[-lost:].all()
    assert "cut" in found.problems[0][1]


def test_movie_fragments_are_read_and_a_cut_one_is_noticed(whole: dict[str, Path], tmp_path: Path) -> None:
    data = fragmented(whole["mjpg.mp4"].read_bytes())
    found = of(tmp_path / "v.mp4", data)
    assert found is not None
    assert found.pts_ns is not None
    assert found.pts_ns.tolist() == [STEP * k for k in range(FRAMES)]
    assert not found.broken.any()
    cut = of(tmp_path / "w.mp4", data[:-100])
    assert cut is not None
    assert cut.frames == FRAMES
    assert cut.broken.tolist() == [False] * (FRAMES - 1) + [True]


def test_an_edit_list_hides_frames(whole: dict[str, Path], tmp_path: Path) -> None:
    data = bytearray(whole["mjpg.mp4"].read_bytes())
    at = data.index(b"elst") + 12  # the first entry: duration [ms], start [ticks]
    scale = struct.unpack_from(">I", data, data.index(b"mdhd") + 16)[0]
    struct.pack_into(">II", data, at, 1000, scale // 2)
    found = of(tmp_path / "v.mp4", bytes(data))
    assert found is not None
    assert found.pts_ns is not None
    assert found.pts_ns.tolist() == [STEP * k for k in range(20)]


def test_an_edit_list_of_64_bits_is_read_as_a_whole(whole: dict[str, Path], tmp_path: Path) -> None:
    """The upper half of a length was left out: of 50 days as many frames were shown as in what is beyond 2**32 ms."""
    data = bytearray(whole["mjpg.mp4"].read_bytes())
    at = data.index(b"elst") + 4
    long = b"\1\0\0\0" + struct.pack(">IQqI", 1, 2**32 + 500, 0, 1 << 16)
    data[at : at + 20] = long
    for box in (b"moov", b"trak", b"edts", b"elst"):
        place = data.index(box) - 4
        struct.pack_into(">I", data, place, struct.unpack_from(">I", data, place)[0] + len(long) - 20)
    found = of(tmp_path / "v.mp4", bytes(data))
    assert found is not None
    assert found.frames == FRAMES


def test_frames_that_an_avi_recorder_dropped_are_not_expected(tmp_path: Path) -> None:
    chunks = [jpeg(k) if k not in (3, 4, 9) else b"" for k in range(12)]
    found = of(tmp_path / "v.avi", avi(chunks))
    assert found is not None
    assert found.pts_ns is not None
    assert found.pts_ns.tolist() == [STEP * k for k in range(12) if k not in (3, 4, 9)]
    assert found.packets is not None
    assert found.packets.tolist() == [0, 1, 2, -1, -1, 3, 4, 5, 6, -1, 7, 8]


def test_zeros_behind_an_avi_file_are_no_fault(tmp_path: Path) -> None:
    found = of(tmp_path / "v.avi", avi([jpeg(k) for k in range(5)]) + bytes(4096))
    assert found is not None
    assert (found.frames, found.problems) == (5, ())


def test_an_avi_header_that_was_never_completed_is_reported(tmp_path: Path) -> None:
    found = of(tmp_path / "v.avi", avi([jpeg(k) for k in range(5)], announced=0))
    assert found is not None
    assert found.frames == 5
    assert any("never completed" in what for _, what in found.problems)


def test_a_changed_byte_in_a_matroska_cluster_breaks_its_check_sum(whole: dict[str, Path], tmp_path: Path) -> None:
    data = bytearray(whole["mjpg.mkv"].read_bytes())
    data[len(data) // 2] ^= 1
    found = of(tmp_path / "v.mkv", bytes(data))
    assert found is not None
    assert any("check sum" in what for _, what in found.problems)


def test_matroska_frames_lost_in_the_middle_keep_their_places(whole: dict[str, Path], tmp_path: Path) -> None:
    data = bytearray(whole["mp4v.mkv"].read_bytes())
    second = data.index(b"\x1f\x43\xb6\x75", data.index(b"\x1f\x43\xb6\x75") + 4)
    data[second : second + 200] = bytes(200)
    found = of(tmp_path / "v.mkv", bytes(data))
    assert found is not None
    assert found.pts_ns is not None
    assert found.pts_ns.tolist() == [STEP * k for k in range(FRAMES)]
    assert 0 < found.broken.sum() < FRAMES


def test_an_unknown_container_is_none(tmp_path: Path) -> None:
    assert of(tmp_path / "v.mp4", b"this is not a video at all" * 10) is None


@pytest.mark.parametrize("name", ["mjpg.mp4", "mjpg.avi", "mjpg.mkv", "fragmented.mp4"])
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_mutilated_files_never_escape_the_parser(
    whole: dict[str, Path], tmp_path: Path, name: str, data: st.DataObject
) -> None:
    original = whole.get(name, whole["mjpg.mp4"]).read_bytes()
    content = bytearray(fragmented(original) if name == "fragmented.mp4" else original)
    structure = sorted({*range(min(2000, len(content))), *range(max(len(content) - 2000, 0), len(content))})
    for _ in range(data.draw(st.integers(1, 8))):
        content[data.draw(st.sampled_from(structure))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(1, len(content)))
    found = of(tmp_path / f"m_{name}", bytes(content[:cut]))
    if found is not None and found.pts_ns is not None:
        assert len(found.broken) == len(found.pts_ns)
        assert (np.diff(found.pts_ns) >= 0).all()
        assert found.frames is not None
        assert found.frames < 20_000_000


def test_a_chunk_that_reaches_beyond_its_list_does_not_hold_the_walk(tmp_path: Path) -> None:
    data = bytearray(avi([jpeg(k) for k in range(5)]))
    movi = data.index(b"movi") - 4
    third = data.index(b"00dc", data.index(b"00dc", data.index(b"00dc", movi) + 1) + 1)
    struct.pack_into("<I", data, movi, third + 100 - movi - 4)  # the list now ends inside the third chunk
    found = of(tmp_path / "v.avi", bytes(data))
    assert found is not None
    assert found.frames == 5
    assert found.problems


@pytest.mark.parametrize("head", [b"\0\0\0\1\x67\x42", b"\xff\xd8\xff\xe0"])
def test_pictures_without_a_container_have_no_times(tmp_path: Path, head: bytes) -> None:
    """FFmpeg takes 25 pictures a second for H.264 and motion JPEG that state no rate."""
    path = tmp_path / "stream"
    path.write_bytes(head + bytes(100))
    with pytest.raises(InputError) as caught:
        video_times(path, 25.0)
    assert caught.value.id == "missing-times"
    assert video_times(path, 25.0, fps=Fraction(10)).rate == 10
