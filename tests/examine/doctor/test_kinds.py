"""Bags, sounds, videos, calibrations and large folders for `occlog doctor`; every kind of finding has a test."""

from __future__ import annotations

import re
import sqlite3
import struct
import sys
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import ros_bags as ros
from places import ROOT
from unindexed import unindexed
from video_samples import write_video

from occlog.array_types import NS
from occlog.examine.doctor import run
from occlog.examine.doctor.findings import Finding
from occlog.examine.doctor.run import check_files
from occlog.io.files.provenance import Provenance
from occlog.io.recording.writer import RecordingWriter
from occlog.records.messages import DOCTOR
from occlog.records.tables import Boxes, Truth

POSE = "geometry_msgs/msg/PoseStamped"


def found_in(path: Path) -> list[Finding]:
    return check_files([path]).findings


def one_of(path: Path) -> Finding:
    found = found_in(path)
    assert len(found) == 1, found
    return found[0]


def poses(late_s: float, count: int = 12) -> list[ros.Row]:
    """Poses that are recorded some time after their stamps."""
    times = [ros.START + n * ros.STEP for n in range(count)]
    return [("/p", POSE, t + round(late_s * 1e9), ros.pose(t, "map", (0, 0, 0))) for t in times]


@pytest.mark.parametrize(("late_s", "kinds"), [(0.0, []), (0.5, []), (0.501, ["two-clocks"]), (-0.501, ["two-clocks"])])
def test_bags_recorded_at_other_times_than_their_stamps(tmp_path: Path, late_s: float, kinds: list[str]) -> None:
    found = found_in(ros.write_mcap(tmp_path / "b.mcap", poses(late_s)))
    assert [f.kind for f in found] == kinds
    assert all(f.location == "/p" and f"{late_s:.3g}" in f.value for f in found)


@pytest.mark.parametrize(
    ("drift", "step_s", "kind", "value"),
    [(5e-3, 0.0, "drift", "+5000 ppm"), (0.0, 4.2, "jump", "by 4.2 s"), (0.0, -4.2, "jump", "by -4.2 s")],
)
def test_bags_with_stamps_of_a_clock_that_drifts_or_is_set(
    tmp_path: Path, drift: float, step_s: float, kind: str, value: str
) -> None:
    logs = [ros.START + 4 * n * ros.STEP for n in range(200)]
    stamps = [
        ros.START + round((1.0 + drift) * (t - ros.START)) + round(step_s * NS) * (n > 90) for n, t in enumerate(logs)
    ]
    rows = [("/p", POSE, log, ros.pose(t, "map", (0, 0, 0))) for log, t in zip(logs, stamps, strict=True)]
    found = [each for each in found_in(ros.write_mcap(tmp_path / "b.mcap", rows)) if each.kind in ("drift", "jump")]
    assert [(each.kind, value in each.value) for each in found] == [(kind, True)]


ODAS_HOPS = [4 * k for k in range(40)]


@pytest.mark.parametrize(("hops", "kinds"), [(ODAS_HOPS, []), ([*ODAS_HOPS, *ODAS_HOPS], ["unreadable"])])
def test_logs_of_directions_are_known_and_counts_that_begin_again_are_found(
    tmp_path: Path, hops: list[int], kinds: list[str]
) -> None:
    source = '{"id": 1, "tag": "", "x": 0.6, "y": 0.8, "z": 0.0, "activity": 0.9}'
    path = tmp_path / "sst.json"
    path.write_text("\n".join(f'{{"timeStamp": {hop}, "src": [{source}]}}' for hop in hops))
    found = found_in(path)
    assert [each.kind for each in found] == kinds
    assert all("goes back by 156 s; it starts again there" in each.value for each in found)
    table = tmp_path / "array.csv"
    table.write_text("time,azimuth_deg\n" + "".join(f"{0.1 * k:.1f},{k}\n" for k in range(20)))
    assert found_in(table) == []


def test_recordings_without_an_index(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    with RecordingWriter(path, None, Provenance("test")) as out:
        out.table(Truth.of(t_ns=[10**9], target_id=[0], role=["target"], x=[1.0], y=[2.0], z=[0.0]))
    assert found_in(path) == []
    path.write_bytes(unindexed(path.read_bytes()))
    assert one_of(path).kind == "no-index"


def test_bags_that_were_cut(tmp_path: Path) -> None:
    path = ros.write_mcap(tmp_path / "b.mcap", poses(0.0, 200))
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    assert {f.kind for f in found_in(path)} == {"damaged-bag"}


def test_bags_whose_metadata_count_too_few(tmp_path: Path) -> None:
    ros.write_mcap(tmp_path / "b.mcap", poses(0.0, 3))
    ros.write_metadata(tmp_path, ["b.mcap"], {"/p": 2})
    found = one_of(tmp_path)
    assert (found.kind, found.location) == ("message-count-mismatch", "/p")


def test_messages_of_bags_that_are_not_of_their_type(tmp_path: Path) -> None:
    path = ros.write_db3(tmp_path / "b.db3", poses(0.0))
    with closing(sqlite3.connect(path)) as base:
        base.execute("UPDATE messages SET data = substr(data, 1, 40) WHERE id = 6")
        base.commit()
    found = found_in(path)
    assert [(f.kind, f.location) for f in found] == [("lost-message", "/p")]


def test_messages_of_which_the_times_of_recording_alone_are_known(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = ros.write_mcap(tmp_path / "b.mcap", poses(0.0))
    monkeypatch.setitem(sys.modules, "rosbags.typesys", None)
    found = one_of(path)
    assert (found.kind, found.location) == ("undecoded", "/p")
    assert "rosbags" in found.value


def test_sounds_that_were_cut(tmp_path: Path) -> None:
    head = b"WAVEfmt " + struct.pack("<IHHIIHH", 16, 1, 1, 8000, 16000, 2, 16) + b"data" + struct.pack("<I", 1600)
    whole = b"RIFF" + struct.pack("<I", len(head) + 1600) + head + bytes(1600)
    path = tmp_path / "s.wav"
    path.write_bytes(whole)
    assert found_in(path) == []
    path.write_bytes(whole[:-200])
    found = one_of(path)
    assert (found.kind, found.n_locations, found.value) == ("sound", 100, "the file ends too early")


@pytest.mark.parametrize(("shift_ms", "kinds"), [(0, []), (4, []), (20, ["variable-frame-rate"])])
def test_videos_whose_frames_come_at_uneven_times(tmp_path: Path, shift_ms: int, kinds: list[str]) -> None:
    path = write_video(tmp_path / "v.mkv", 30, "MJPG")
    # Check sums of clusters become empty elements
    data = bytearray(path.read_bytes().replace(b"\xbf\x84", b"\xec\x84"))
    # The time of a block in its cluster, in milliseconds, stands between the number of its track and its flags
    blocks = [found.start() + 1 for found in re.finditer(rb"\x81..\x80\xff\xd8\xff", data, re.DOTALL)]
    assert len(blocks) == 30
    for at in blocks[1:29:3]:
        data[at : at + 2] = struct.pack(">h", struct.unpack(">h", data[at : at + 2])[0] + shift_ms)
    path.write_bytes(data)
    found = found_in(path)
    assert [f.kind for f in found] == kinds
    assert all("20 of 29 intervals; 0.03 to 0.07 s" in f.value for f in found)


def test_calibrations_whose_unit_may_be_another(tmp_path: Path) -> None:
    path, inner = tmp_path / "c.npz", np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    for apart, kinds in ((5.0, []), (5000.0, ["suspect"])):
        outer = [np.column_stack([np.eye(3), [x, 0, 0]]) for x in (0, apart)]
        np.savez(path, a=inner @ outer[0], b=inner @ outer[1])
        found = found_in(path)
        assert [f.kind for f in found] == kinds
    assert "5e+03 m apart" in found[0].value


def test_folders_with_more_files_than_are_looked_at(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run, "MAX_FILES", 3)
    for name in "abc":
        (tmp_path / f"{name}.xyz").write_text("x")
    assert found_in(tmp_path) == []
    (tmp_path / "d.xyz").write_text("x")
    found = one_of(tmp_path)
    assert (found.kind, found.value) == ("not-checked", "files after the first 3")


def test_every_kind_of_finding_has_a_test() -> None:
    tests = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "tests/examine/doctor").glob("*.py"))
    assert [kind for kind in DOCTOR if f'"{kind}"' not in tests] == []


@pytest.mark.parametrize(("moves", "kinds"), [(True, ["frozen-camera"]), (False, [])])
def test_a_camera_that_repeats_its_boxes(tmp_path: Path, *, moves: bool, kinds: list[str]) -> None:
    """Two boxes of camera b are the same from 6 s on, while those of a go on, or stand still as well."""
    path, frames = tmp_path / "r.mcap", np.arange(100)
    columns = {"left_px": 0.0, "top_px": 30.0, "width_px": 20.0, "height_px": 50.0, "confidence": 0.9}
    with RecordingWriter(path, None, Provenance("test")) as out:
        for name, stop in (("a", 100 if moves else 60), ("b", 60)):
            shift = np.repeat(np.minimum(frames, stop), 2)
            box = np.tile([0, 1], 100)
            rows = {key: np.full(200, value) for key, value in columns.items()} | {"left_px": 100.0 * box + shift}
            out.table(
                Boxes.of(
                    t_ns=np.repeat(frames, 2) * 10**8,
                    sensor=np.full(200, name),
                    frame=np.repeat(frames, 2),
                    box=box,
                    target_id=np.full(200, -1),
                    **rows,
                )
            )
    found = found_in(path)
    assert [f.kind for f in found] == kinds
    assert all("sensor b, from 1970-01-01T00:00:06" in f.location and "40 identical" in f.value for f in found)
