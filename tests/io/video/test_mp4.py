"""Limits of the MP4 parser, on files made box by box (ISO/IEC 14496-12)."""

from __future__ import annotations

import struct
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from video_samples import box

from occlog.errors import InputError
from occlog.io.frames.streams import video_times
from occlog.io.video.container import MAX_FRAMES, Container
from occlog.io.video.reader import read_container

SIZES = (5, 3, 4)


def parsed(folder: Path, data: bytes) -> Container:
    path = folder / "v.mp4"
    path.write_bytes(data)
    found = read_container(path)
    assert found is not None
    return found


def table(name: bytes, rows: list[tuple[int, ...]], count: int | None = None) -> bytes:
    """A box with a version, a count and rows of numbers."""
    body = b"".join(struct.pack(f">{len(row)}I", *row) for row in rows)
    return box(name, struct.pack(">II", 0, len(rows) if count is None else count) + body)


def samples(sizes: tuple[int, ...] = SIZES, offset: int = 0, duration: int = 40) -> bytes:
    """Sample table of frames that lie one behind the other."""
    stsz = box(b"stsz", struct.pack(">III", 0, 0, len(sizes)) + struct.pack(f">{len(sizes)}I", *sizes))
    return (
        stsz
        + table(b"stts", [(len(sizes), duration)])
        + table(b"stsc", [(1, len(sizes), 1)])
        + table(b"stco", [(offset,)])
    )


def movie(
    stbl: bytes, scale: int = 1000, handler: bytes = b"vide", edits: list[tuple[int, ...]] | None = None
) -> bytes:
    mdhd = box(b"mdhd", struct.pack(">IIIIII", 0, 0, 0, scale, 0, 0))
    hdlr = box(b"hdlr", struct.pack(">II4s", 0, 0, handler) + bytes(12))
    mdia = box(b"mdia", mdhd + hdlr + box(b"minf", box(b"stbl", stbl)))
    mvhd = box(b"mvhd", struct.pack(">IIII", 0, 0, 0, 100))
    edts = b"" if edits is None else box(b"edts", table(b"elst", edits))
    return box(b"moov", mvhd + box(b"trak", box(b"tkhd", struct.pack(">IIII", 0, 0, 0, 1)) + edts + mdia))


def whole(sizes: tuple[int, ...] = SIZES) -> bytes:
    """A file whose frames are its last bytes."""
    head = len(movie(samples(sizes))) + 8
    return movie(samples(sizes, offset=head)) + box(b"mdat", bytes(sum(sizes)))


def test_frames_have_the_times_of_the_table(tmp_path: Path) -> None:
    found = parsed(tmp_path, whole())
    assert found.pts_ns is not None
    assert found.pts_ns.tolist() == [0, 40_000_000, 80_000_000]
    assert (found.rate, found.problems) == (Fraction(25), ())


def test_a_frame_is_broken_when_its_last_byte_is_missing(tmp_path: Path) -> None:
    assert parsed(tmp_path, whole()).broken.tolist() == [False, False, False]
    assert parsed(tmp_path, whole()[:-1]).broken.tolist() == [False, False, True]
    assert parsed(tmp_path, whole()[:-4]).broken.tolist() == [False, False, True]
    assert parsed(tmp_path, whole()[:-5]).broken.tolist() == [False, True, True]


def test_times_of_one_tick_per_second_are_read_and_of_none_are_not(tmp_path: Path) -> None:
    slow = parsed(tmp_path, movie(samples(duration=1), scale=1))
    assert slow.pts_ns is not None
    assert slow.pts_ns.tolist() == [0, 10**9, 2 * 10**9]
    assert "a time scale of 0" in parsed(tmp_path, movie(samples(), scale=0)).problems[-1][1]


PAUSE, SPEED = 2**32 - 1, 1 << 16


@pytest.mark.parametrize(
    ("edits", "shown"),
    [
        ([(50, PAUSE, SPEED), (12, 0, SPEED)], [0, 40, 80]),
        ([(4, 0, SPEED), (4, 40, SPEED)], [0, 40]),
        ([(4, 40, SPEED), (8, 80, SPEED)], [0, 40]),
        ([(0, 40, SPEED)], [0, 40]),
    ],
)
def test_an_edit_list_may_begin_with_a_pause_and_play_parts_that_go_on(
    tmp_path: Path, edits: list[tuple[int, ...]], shown: list[int]
) -> None:
    found = parsed(tmp_path, movie(samples(), edits=edits))
    assert found.pts_ns is not None
    assert [t // 10**6 for t in found.pts_ns.tolist()] == shown
    assert found.problems == ()


@pytest.mark.parametrize(
    "edits",
    [
        [(4, 0, SPEED), (4, 80, SPEED)],
        [(4, 0, SPEED), (4, 0, SPEED)],
        [(4, 0, SPEED), (50, PAUSE, SPEED), (8, 40, SPEED)],
        [(6, 0, 2 * SPEED)],
        [(50, 0, 0), (12, 0, SPEED)],
    ],
)
def test_that_an_edit_list_changes_times_is_reported(tmp_path: Path, edits: list[tuple[int, ...]]) -> None:
    """Frames were left out, shown twice or at other times without a word."""
    found = parsed(tmp_path, movie(samples(), edits=edits))
    assert found.frames is None
    assert [place for place, _ in found.problems] == ["edit list"]


def test_times_beyond_all_numbers_are_reported(tmp_path: Path) -> None:
    """They became other times."""
    found = parsed(tmp_path, movie(samples(sizes=(1,) * 9, duration=2**31 - 1), scale=1))
    assert found.frames is None
    assert "beyond 2^62 ns" in found.problems[-1][1]


def test_a_table_of_times_that_is_too_short_is_reported(tmp_path: Path) -> None:
    """The mean of 40 ms and of the missing ones, 0, was taken for the frame rate: twice the right one."""
    found = parsed(
        tmp_path, movie(samples(sizes=(1,) * 4).replace(struct.pack(">II", 4, 40), struct.pack(">II", 2, 40)))
    )
    assert found.rate == 25
    assert "has those of 2 of 4 samples" in found.problems[0][1]


def test_times_that_repeat_need_a_frame_rate(tmp_path: Path) -> None:
    parsed(tmp_path, movie(samples(duration=0)))
    with pytest.raises(InputError, match="repeat, and it states no frame rate; give"):
        video_times(tmp_path / "v.mp4")
    assert video_times(tmp_path / "v.mp4", fps=Fraction(5)).rate == 5


def test_a_box_is_at_least_as_long_as_its_head(tmp_path: Path) -> None:
    empty = struct.pack(">I4s", 8, b"free")
    assert parsed(tmp_path, empty + movie(samples())).frames == 3
    short = struct.pack(">I4s", 7, b"free")
    assert "no box of an MP4 file begins there" in parsed(tmp_path, movie(samples()) + short).problems[0][1]


def test_sizes_of_64_bits_and_boxes_to_the_end_are_read(tmp_path: Path) -> None:
    moov = movie(samples())
    long = struct.pack(">I4sQ", 1, b"moov", len(moov) + 8) + moov[8:]
    assert parsed(tmp_path, long).frames == 3
    to_the_end = struct.pack(">I4s", 0, b"mdat") + bytes(100)
    assert parsed(tmp_path, moov + to_the_end).problems == ()


def test_a_table_may_fill_its_box_and_not_more(tmp_path: Path) -> None:
    rows = [(3, 40)]
    for count, known in ((1, True), (2, False)):
        stbl = samples().replace(table(b"stts", rows), table(b"stts", rows, count))
        found = parsed(tmp_path, movie(stbl))
        assert (found.frames is not None) == known
        assert known or "table stts of 2 entries is longer than its box" in found.problems[-1][1]


def test_more_equal_samples_than_the_limit_are_not_believed(tmp_path: Path) -> None:
    stbl = samples().replace(samples()[: samples().index(b"stts") - 4], b"")
    uniform = box(b"stsz", struct.pack(">III", 0, 1, MAX_FRAMES + 1))
    assert f"{MAX_FRAMES + 1} samples announced" in parsed(tmp_path, movie(uniform + stbl)).problems[-1][1]
    uniform = box(b"stsz", struct.pack(">III", 0, 1, 3))
    assert parsed(tmp_path, movie(uniform + stbl)).frames == 3
    long = len(movie(uniform + stbl))
    for count, known in ((long // 8, True), (long // 8 + 1, False)):  # each takes some bytes at least
        uniform = box(b"stsz", struct.pack(">III", 0, 1, count))
        assert (parsed(tmp_path, movie(uniform + stbl)).frames is not None) == known


@pytest.mark.parametrize("first", [(2,), (1, 1), (3, 1), (0, 1), (1, 2)])
def test_numbers_of_chunks_rise(tmp_path: Path, first: tuple[int, ...]) -> None:
    """Each step back filled the table again: 8 MB of them took a minute."""
    rows = [(number, 1, 1) for number in first]
    stbl = samples().replace(table(b"stsc", [(1, 3, 1)]), table(b"stsc", rows))
    assert "do not increase from 1" in parsed(tmp_path, movie(stbl)).problems[-1][1]


def fragments(runs: list[tuple[int, int, bytes]], clock: int = 0) -> bytes:
    """A movie whose samples are in one fragment: flags, count and fields of each of its runs."""
    none = b"".join(table(name, []) for name in (b"stts", b"stsc", b"stco"))
    index = movie(box(b"stsz", bytes(12)) + none)
    mvex = box(b"mvex", box(b"trex", struct.pack(">6I", 0, 1, 1, 7, 11, 0)))
    index = box(b"moov", index[8:] + mvex)
    tfhd, tfdt = box(b"tfhd", struct.pack(">II", 0, 1)), box(b"tfdt", struct.pack(">IQ", 1 << 24, clock))
    truns = b"".join(box(b"trun", struct.pack(">II", flags, count) + fields) for flags, count, fields in runs)
    return index + box(b"moof", box(b"traf", tfhd + tfdt + truns))


@pytest.mark.parametrize(
    "flags", [sum(bit for k, bit in enumerate((0x100, 0x200, 0x400, 0x800)) if n >> k & 1) for n in range(16)]
)
def test_runs_of_fragments_are_as_each_sample_says(tmp_path: Path, flags: int) -> None:
    """Against a loop over samples: default durations and sizes are 7 and 11, and times go on from run to run."""
    rng = np.random.default_rng(flags)
    runs, reported, clock = [], [], 30
    for count in (3, 1, 4):
        names = [bit for bit in (0x100, 0x200, 0x400, 0x800) if flags & bit]
        rows = [{name: int(rng.integers(1, 50)) for name in names} for _ in range(count)]
        runs.append((flags, count, b"".join(struct.pack(">i", row[name]) for row in rows for name in names)))
        for row in rows:
            reported.append(clock + row.get(0x800, 0))
            clock += row.get(0x100, 7)
    found = parsed(tmp_path, fragments(runs, 30))
    assert found.pts_ns is not None
    assert found.pts_ns.tolist() == [(t - min(reported)) * 1_000_000 for t in sorted(reported)]


def test_runs_of_more_samples_than_the_file_has_bytes_for_are_not_believed(tmp_path: Path) -> None:
    """Seven million of them, which take no byte of the file to say, took 10 s, and ten runs of a million 1 GB."""
    most = len(fragments([(0, 3, b"")])) // 8
    for count, known in ((most, True), (most + 1, False), (7_000_000, False)):
        found = parsed(tmp_path, fragments([(0, count, b"")]))
        assert (found.frames == count) == known
        assert known or f"a fragment of {count} frames is longer" in found.problems[-1][1]
    assert parsed(tmp_path, fragments([(0, most, b"")] * 3)).frames is None
    for clock, known in ((2**62 - 1, True), (2**62, False)):
        assert (parsed(tmp_path, fragments([(0, 1, b"")], clock)).frames == 1) == known


def test_the_index_and_a_video_track_are_needed(tmp_path: Path) -> None:
    assert "box moov) is missing" in parsed(tmp_path, box(b"mdat", b"")).problems[-1][1]
    assert "no video track" in parsed(tmp_path, movie(samples(), handler=b"soun")).problems[-1][1]


@pytest.mark.parametrize(("data", "known"), [(b"\0\0\0\x08fre", False), (b"\0\0\0\x08free", True), (bytes(8), False)])
def test_eight_bytes_make_an_mp4_file(tmp_path: Path, data: bytes, known: bool) -> None:
    path = tmp_path / "v.mp4"
    path.write_bytes(data)
    assert (read_container(path) is not None) == known


def test_a_second_film_behind_the_first_is_reported(tmp_path: Path) -> None:
    """As `cat a.mp4 b.mp4` writes them; FFmpeg reads the first."""
    named = box(b"ftyp", b"isom") + whole()
    found = parsed(tmp_path, named + named)
    assert found.frames == len(SIZES)
    ((where, what),) = found.problems
    assert where == f"byte {len(named)}"
    assert what.startswith("another video of 3 frames, which are not read, from there on")
    assert f"tail -c +{len(named) + 1}" in what
    ((_, what),) = parsed(tmp_path, named * 3).problems
    assert what.startswith("2 more videos of 6 frames")


def test_an_index_without_samples_may_be_repeated(tmp_path: Path) -> None:
    """Segments of a stream, each with its own beginning (ftyp, moov) before its fragments."""
    begin = box(b"ftyp", b"isom") + movie(samples(()))
    assert parsed(tmp_path, box(b"ftyp", b"isom") + whole() + begin + begin).problems == ()
    assert parsed(tmp_path, box(b"ftyp", b"isom") + whole() + box(b"free", b"")).problems == ()
