"""Limits of the Matroska parser, on files made element by element."""

from __future__ import annotations

import struct
import zlib
from fractions import Fraction
from pathlib import Path

import pytest
from stream_samples import H264

from occlog.io.frames.decode import decode, examine
from occlog.io.video.container import MAX_FAULTS, SPHERE, STEREO, Container
from occlog.io.video.reader import read_container
from occlog.records.losses import Loss

STEP = 40_000_000


def element(ident: int, content: bytes, size: bytes | None = None) -> bytes:
    """One EBML element with an 8-byte size, or a given one."""
    name = ident.to_bytes((ident.bit_length() + 7) // 8, "big")
    return name + (size or (len(content) | 1 << 56).to_bytes(8, "big")) + content


def number(ident: int, value: int) -> bytes:
    return element(ident, value.to_bytes(8, "big"))


def block(shift_ms: int, track: int = 1, flags: int = 0, picture: bytes = b"picture") -> bytes:
    return element(0xA3, bytes([0x80 | track]) + struct.pack(">hB", shift_ms, flags) + picture)


def cluster(time_ms: int, *blocks: bytes, size: bytes | None = None) -> bytes:
    return element(0x1F43B675, number(0xE7, time_ms) + b"".join(blocks), size)


def video(
    *clusters: bytes, duration: bytes = b"", codec: bytes = b"V_MJPEG", kind: int = 1, more: bytes = b""
) -> bytes:
    info = element(0x1549A966, number(0x2AD7B1, 1_000_000) + duration)
    track = number(0xD7, 1) + number(0x83, kind) + number(0x23E383, STEP) + element(0x86, codec) + more
    tracks = element(0x1654AE6B, element(0xAE, track))
    return element(0x1A45DFA3, b"") + element(0x18538067, info + tracks + b"".join(clusters))


def parsed(folder: Path, data: bytes) -> Container:
    path = folder / "v.mkv"
    path.write_bytes(data)
    found = read_container(path)
    assert found is not None
    return found


def times(found: Container) -> list[int]:
    assert found.pts_ns is not None
    return [t // 1_000_000 for t in found.pts_ns.tolist()]


def test_blocks_count_from_their_cluster_in_both_directions(tmp_path: Path) -> None:
    found = parsed(tmp_path, video(cluster(0, block(0)), cluster(100, block(20), block(-20), block(60))))
    assert times(found) == [0, 80, 120, 160]
    assert (found.rate, found.problems) == (Fraction(25), ())


@pytest.mark.parametrize(("time", "tick_ns"), [(2**63, 1), (2**40, 2**30), (1, 2**64 - 1)])
def test_times_beyond_all_numbers_are_reported(tmp_path: Path, time: int, tick_ns: int) -> None:
    """They ended the command with an error of NumPy, or became other times."""
    data = video(cluster(time, block(0), block(1))).replace(number(0x2AD7B1, 1_000_000), number(0x2AD7B1, tick_ns))
    found = parsed(tmp_path, data)
    assert found.frames is None
    assert "beyond 2^62 ns" in found.problems[-1][1]


@pytest.mark.parametrize(("scale", "shown"), [(0.5, [0, 20, 100]), (2.0, [0, 80, 100]), (0.0, [0, 40, 100])])
def test_a_track_may_have_ticks_of_its_own(tmp_path: Path, scale: float, shown: list[int]) -> None:
    own = element(0x23314F, struct.pack(">f", scale))
    data = video(cluster(0, block(0), block(40)), cluster(100, block(0)), more=own)
    assert times(parsed(tmp_path, data)) == shown


@pytest.mark.parametrize(
    ("yaw", "roll", "how"),
    [
        (0.0, 90.0, ""),
        (180.0, 0.0, "left to right"),
        (-180.0, 180.0, "top to bottom"),
        (180.0, 90.0, "along the diagonal from top left"),
        (180.0, -90.0, "along the diagonal from top right"),
        (180.0, 45.0, "at another angle"),
    ],
)
def test_a_mirror_is_a_yaw_of_180_degrees_with_a_roll(tmp_path: Path, yaw: float, roll: float, how: str) -> None:
    """As FFmpeg writes and reads it."""
    pose = element(0x7673, struct.pack(">f", yaw)) + element(0x7675, struct.pack(">f", roll))
    shown = element(0xE0, element(0x7670, pose))
    assert parsed(tmp_path, video(cluster(0, block(0)), more=shown)).mirror == how


@pytest.mark.parametrize(("mode", "sphere", "undone"), [(1, 0, STEREO), (0, 1, SPHERE), (0, 0, "")])
def test_stereo_and_spherical_pictures_and_further_tracks(tmp_path: Path, mode: int, sphere: int, undone: str) -> None:
    shown = element(0xE0, number(0x53B8, mode) + element(0x7670, number(0x7671, sphere)))
    data = video(cluster(0, block(0)), more=shown)
    assert (parsed(tmp_path, data).undone, parsed(tmp_path, data).tracks) == (undone, 1)


def test_faults_are_reported_up_to_a_limit(tmp_path: Path) -> None:
    """Four bytes made one: 4 MB took 320 MB, and a million lines."""
    rest = b"\x1f\x43\xb6\x75\x81\x00" * 1000
    problems = parsed(tmp_path, video(cluster(0, block(0)), rest)).problems
    assert len(problems) == MAX_FAULTS + 1
    assert problems[-1][1].endswith("more positions")


def test_blocks_of_other_tracks_and_pictures_that_are_not_shown_are_no_frames(tmp_path: Path) -> None:
    blocks = block(0), block(10, track=2), block(40), block(60, flags=0x08), block(80)
    assert times(parsed(tmp_path, video(cluster(0, *blocks)))) == [0, 40, 80]
    vp8 = [block(0, picture=b"\x10"), block(40, picture=b"\x00"), block(80, picture=b"\x10")]
    assert times(parsed(tmp_path, video(cluster(0, *vp8), codec=b"V_VP8"))) == [0, 80]


def test_a_cluster_of_unknown_size_ends_where_the_next_begins(tmp_path: Path) -> None:
    unknown = b"\x01" + b"\xff" * 7
    clusters = cluster(0, block(0), block(40), size=unknown), cluster(80, block(0), size=unknown)
    found = parsed(tmp_path, video(*clusters))
    assert times(found) == [0, 40, 80]
    assert found.problems == ()


def test_a_wrong_check_sum_is_reported_and_a_right_one_is_not(tmp_path: Path) -> None:
    content = number(0xE7, 0) + block(0) + block(40)
    for change, reported in ((0, False), (1, True)):
        crc = element(0xBF, struct.pack("<I", zlib.crc32(content) ^ change), b"\x84")
        found = parsed(tmp_path, video(element(0x1F43B675, crc + content)))
        assert times(found) == [0, 40]
        assert any("wrong check sum of this cluster" in what for _, what in found.problems) == reported


def test_the_frames_of_a_cut_file_are_counted_by_its_duration(tmp_path: Path) -> None:
    """The recorder announced 200 ms, 5 frames; the file ends behind 3 of them."""
    for duration in (element(0x4489, struct.pack(">d", 200.0)), element(0x4489, struct.pack(">f", 200.0))):
        data = video(cluster(0, block(0), block(40), block(80)), cluster(120, block(0), block(40)), duration=duration)
        cut = data[: data.index(b"\x1f\x43\xb6\x75", data.index(b"\x1f\x43\xb6\x75") + 1)]
        found = parsed(tmp_path, cut)
        assert times(found) == [0, 40, 80, 120, 160]
        assert found.broken.tolist() == [False, False, False, True, True]
        assert times(parsed(tmp_path, data)) == [0, 40, 80, 120, 160]
        assert not parsed(tmp_path, data).broken.any()


def test_the_first_frames_are_lost_when_the_first_one_left_is_more_than_a_step_from_the_start(tmp_path: Path) -> None:
    damage = bytes(4)  # makes the parser search for the next cluster
    for first, lost in ((40, 0), (80, 2)):
        found = parsed(tmp_path, video(damage + cluster(first, block(0), block(40))))
        assert found.problems
        assert int(found.broken.sum()) == lost
        assert found.first_ns == (first * 1_000_000 if lost else 0)


def test_frames_that_a_whole_file_does_not_have_are_not_missing(tmp_path: Path) -> None:
    found = parsed(tmp_path, video(cluster(0, block(0), block(40), block(200))))
    assert times(found) == [0, 40, 200]
    assert not found.broken.any()


@pytest.mark.parametrize("kind", [2, 17])
def test_a_video_track_is_needed(tmp_path: Path, kind: int) -> None:
    found = parsed(tmp_path, video(cluster(0, block(0)), kind=kind))
    assert found.frames is None
    assert found.problems[-1] == ("header", "no video track is named")


@pytest.mark.parametrize("first", [0, 1, 3])
def test_frames_before_the_first_key_frame_are_lost_and_the_others_keep_their_times(tmp_path: Path, first: int) -> None:
    """FFmpeg counts times from 0, then from the packet at which it knows the order; key frames are 0, 6 and 12."""
    blocks = [block(40 * k, flags=0x80 * (k % 6 == 0), picture=H264[k]) for k in range(first, len(H264))]
    path = tmp_path / "v.mkv"
    path.write_bytes(video(cluster(0, *blocks), codec=b"V_MPEG4/ISO/AVC"))
    found = examine(path)
    assert found.container is not None
    missing = (6 - first) % 6
    assert found.container.first_key == missing
    losses: list[Loss] = []
    pictures = [
        (p.index + first, round((float(p.image[:, :24].mean()) - 20) / 10))
        for p in decode(found, 0, None, losses.append)
    ]
    assert pictures == [(k, k) for k in range(first + missing, len(H264))]
    assert [loss.count for loss in losses] == ([missing] if missing else [])


def test_a_group_without_a_reference_holds_a_key_frame(tmp_path: Path) -> None:
    plain = element(0xA1, b"\x81" + struct.pack(">hB", 40, 0) + b"picture")
    later = element(0xA0, plain + element(0xFB, b"\xd8"))
    assert parsed(tmp_path, video(cluster(0, later))).first_key == 0
    key = element(0xA0, plain.replace(struct.pack(">h", 40), struct.pack(">h", 80)))
    assert parsed(tmp_path, video(cluster(0, later, key, block(120)))).first_key == 1
