"""`occlog doctor`: every kind of finding by files made by hand, and none in files that are whole."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from jsonschema import Draft202012Validator
from places import ROOT

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.examine.doctor.findings import EXIT_CODES, Finding, Findings, finding_schema
from occlog.examine.doctor.recording import check_recording
from occlog.examine.doctor.run import check_files
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.io.frames.codec import encode_image
from occlog.io.recording.reader import open_recording
from occlog.io.recording.writer import RecordingWriter
from occlog.records.losses import Loss
from occlog.records.messages import DOCTOR
from occlog.records.tables import Bearings, Truth

START, STEP = 1_700_000_000_000_000_000, 100_000_000
SAMPLE = ROOT / "sample_data"


def bearings(count: int = 40, sensor: str = "cam1") -> Bearings:
    return Bearings.of(
        t_ns=START + np.arange(count) * STEP,
        sensor=np.full(count, sensor),
        target_id=np.zeros(count, np.int32),
        seen=np.ones(count, bool),
        bearing=np.linspace(0, 1, count),
        sigma=np.full(count, 0.01),
        u_px=np.zeros(count),
        sigma_px=np.ones(count),
        score=np.ones(count),
    )


def table(path: Path, change: Callable[[pa.Table], pa.Table] = lambda t: t) -> Path:
    """A table of 40 bearings, changed past what occlog itself would write."""
    whole = path.with_name("whole.parquet")
    write_table(whole, bearings(), Provenance("test"), overwrite=True)
    pq.write_table(change(pq.read_table(whole)), path)
    whole.unlink()
    return path


def put(name: str, row: int, value: object) -> Callable[[pa.Table], pa.Table]:
    def change(found: pa.Table) -> pa.Table:
        cells = found.column(name).to_pylist()
        cells[row] = value
        at = found.schema.get_field_index(name)
        return found.set_column(at, found.schema.field(at), pa.array(cells, found.schema.field(at).type))

    return change


def entry(key: bytes, value: bytes) -> Callable[[pa.Table], pa.Table]:
    return lambda t: t.replace_schema_metadata({**t.schema.metadata, key: value})


def positions(unit: str, times: Iterable[int]) -> str:
    return f"t_{unit},target_id,x,y\n" + "".join(f"{t},1,0,0\n" for t in times)


SECONDS = range(1_700_000_000, 1_700_000_009)


def recording(
    path: Path, *, times: list[int] | None = None, images: list[bytes] | None = None, true_from: int = START
) -> Path:
    """A recording of truth and of 20 images of one camera."""
    t_ns = [START + n * STEP for n in range(20)] if times is None else times
    image = encode_image(np.full((8, 8), 90, np.uint8), "png", 0)
    data = images or [image] * len(t_ns)
    truth = Truth.of(
        t_ns=true_from + np.arange(20) * STEP,
        target_id=np.zeros(20, np.int32),
        role=np.full(20, "target"),
        **{name: np.zeros(20) for name in ("x", "y", "z")},
    )
    with RecordingWriter(path, None, Provenance("test", losses=(Loss("cam1.avi", "frame 3", "gone", 1),))) as writer:
        for number, (time, each) in enumerate(zip(t_ns, data, strict=True)):
            writer.image("cam1", time, number, each, "png")
        writer.table(truth)
    return path


def found_in(*paths: Path) -> list[Finding]:
    return check_files(paths).findings


def kinds_of(path: Path) -> list[str]:
    return [f.kind for f in found_in(path)]


@pytest.mark.parametrize(
    ("change", "kind", "place", "value"),
    [
        (put("target_id", 3, -7), "row", "row 3", "target_id -7"),
        (put("sigma", 20, float("inf")), "row", "row 20", "inf"),
        (put("bearing", 39, 9.0), "row", "row 39", "bearing 9 rad"),
        (lambda t: t.take([0, 1, 1, *range(2, 40)]), "duplicate-row", "2023-11-14T22:13:20.100Z", "sensor cam1"),
        (lambda t: t.take([0, 2, 1, *range(3, 40)]), "order", "row 2", "Z after"),
        (lambda t: put("bearing", 2, 0.5)(t.take([0, 1, 1, *range(2, 40)])), "duplicate-key", "", "target_id 0"),
        (lambda t: t.take([*range(10), *range(20, 40)]), "gap", "sensor cam1: after", "for 1.1 s"),
        (lambda t: t.drop(["sigma"]), "unreadable", "", "column sigma of bearings is missing"),
        (entry(b"occlog.provenance", b"[1]"), "unreadable", "", "provenance"),
        (entry(b"occlog.schema", b"nothing/1"), "unreadable", "", "nothing"),
    ],
)  # fmt: skip
def test_tables(tmp_path: Path, change: Callable[[pa.Table], pa.Table], kind: str, place: str, value: str) -> None:
    (found,) = found_in(table(tmp_path / "b.parquet", change))
    assert found.kind == kind
    assert found.location.startswith(place)
    assert value in found.value


def test_every_bad_row_of_a_table_is_found(tmp_path: Path) -> None:
    def change(t: pa.Table) -> pa.Table:
        return put("target_id", 3, -7)(put("target_id", 30, -9)(put("sigma", 20, float("nan"))(t)))

    found = found_in(table(tmp_path / "b.parquet", change))
    assert [(f.location, f.n_locations) for f in found] == [("row 3", 2), ("row 20", 1)]


def test_a_damaged_group_does_not_hide_the_others(tmp_path: Path) -> None:
    path = tmp_path / "b.parquet"
    with pq.ParquetWriter(
        path, (t := pq.read_table(table(tmp_path / "a.parquet"))).schema, write_page_checksum=True
    ) as w:
        w.write_table(put("target_id", 3, -7)(t), row_group_size=20)
    data = bytearray(path.read_bytes())
    last = pq.ParquetFile(path).metadata.row_group(1).column(4)
    data[last.dictionary_page_offset + last.total_compressed_size - 2] ^= 4
    path.write_bytes(data)
    found = found_in(path)
    assert [(f.kind, f.location) for f in found] == [("row", "row 3"), ("damaged-table", "rows 20 to 39")]
    assert str(found[1]).count("again") == 1, "the reader says what to do"


def frames(times: Iterable[float]) -> str:
    """A box of one camera in each frame, last ones first."""
    rows = [f"{n},{t},1,2,3,4\n" for n, t in enumerate(times)]
    return "frame,time,left,top,width,height\n" + "".join(reversed(rows))


TEXTS = {
    "frames back": (frames([0.1, 0.2, 0.15, 0.3]), "order", "camera a"),
    "frames jump": (frames(n / 10 + 5 * (n > 9) for n in range(20)), "jump", "camera a: after 1970-01-01T00:00:00.9"),
    "frame of two times": ("frame,time,left,top,width,height\n0,0.1,1,2,3,4\n0,0.2,9,2,3,4\n", "row", "line 3"),
    "copies": (
        "frame,camera,left,top,right,bottom\n0,a,1,2,3,4\n1,a,1,2,3,4\n0,a,1,2,3,4\n",
        "duplicate-row",
        "line 4",
    ),
    "edge": ("frame,camera,left,top,right,bottom\n0,a,-1e308,2,1e308,4\n", "row", "line 2"),
    "nan": ("frame,camera,left,top,right,bottom\n0,a,nan,2,3,4\n", "row", "line 2"),
    "cells": ("frame,camera,left,top,right,bottom\n0,a,1,2,3,4\n1,a,1,2,3\n", "row", "line 3"),
    "mot edge": ("1,1,1e308,2,3,4,0.9,-1,-1,-1\n", "row", "line 1"),
    "mot frame": ("1,1,1,2,3,4,0.9,-1,-1,-1\n2000000000,1,1,2,3,4,0.9,-1,-1,-1\n", "row", "line 2"),
    "mot id": ("1,-5,1,2,3,4,0.9,-1,-1,-1\n", "row", "line 1"),
    "mot cells": ("1,1,1,2,3,4,0.9,-1,-1,-1\n2,1,1,2,3,4,0.9,-1,-1\n", "row", "line 2"),
    "ms in seconds": ("t_s,target_id,x,y\n1700000000000,1,0,0\n", "row", "line 2"),
    "s in ms": (positions("ms", SECONDS), "epoch-unit", ""),
    "s in us": (positions("us", SECONDS), "epoch-unit", ""),
    "s in ns": (positions("ns", SECONDS), "epoch-unit", ""),
    "ms in ns": (positions("ns", (t * 10**3 for t in SECONDS)), "epoch-unit", ""),
    "us in ns": (positions("ns", (t * 10**6 for t in SECONDS)), "epoch-unit", ""),
    "twice": ("t_s,target_id,x,y\n1,1,0,0\n1,1,5,0\n2,1,0,0\n", "row two-positions", "rows 0 and 1"),
    "bad cell": ("t_s,target_id,x,y\n1,1,0,0\n2,1,five,0\n3,1,0,0\n", "row", "line 3"),
    "stamps": ("time\n1.0\n2.0\n1.5\n", "order", "times"),
    "stamps twice": ("time\n1.0\n2.0\n2.0\n", "duplicate-time", "times"),
    "no table": ("a,b\n1,2\n", "no-table", ""),
}  # fmt: skip


def test_frames_without_a_box_are_no_gap(tmp_path: Path) -> None:
    """They say that no one was seen."""
    (tmp_path / "a.csv").write_text(
        "frame,time,left,top,width,height\n" + "".join(f"{n},{n / 10},1,2,3,4\n" for n in (*range(10), *range(40, 50)))
    )
    assert found_in(tmp_path) == []


@pytest.mark.parametrize("name", TEXTS)
def test_texts(tmp_path: Path, name: str) -> None:
    text, kind, place = TEXTS[name]
    path = tmp_path / ("a.txt" if name.startswith("mot") else "a.csv")
    path.write_text(text)
    found = found_in(tmp_path)
    assert [f.kind for f in found] == kind.split()
    assert found[0].location.startswith(place)


def test_many_bad_rows_are_counted_and_not_listed(tmp_path: Path) -> None:
    rows = "".join(f"{n},a,{'x' * (n % 40 + 1)},2,3,4\n" if n % 100 == 0 else f"{n},a,1,2,3,4\n" for n in range(5000))
    (tmp_path / "a.csv").write_text("frame,camera,left,top,right,bottom\n" + rows)
    (found,) = found_in(tmp_path)
    assert (found.kind, found.location, found.n_locations) == ("row", "line 2", 50)


def test_recordings_that_are_whole_have_their_losses_alone(tmp_path: Path) -> None:
    (note,) = found_in(recording(tmp_path / "r.mcap"))
    assert (note.kind, note.location, note.value) == ("losses", "cam1.avi, frame 3", "gone (1 lost)")


def test_recordings_with_flipped_bits_are_read_on(tmp_path: Path) -> None:
    path = recording(tmp_path / "r.mcap", times=[START + n * STEP for n in (*range(10), *range(20, 30))])
    data = bytearray(path.read_bytes())
    data[len(data) // 3] ^= 4
    path.write_bytes(data)
    kinds = kinds_of(path)
    assert "damaged-recording" in kinds
    assert "losses" in kinds


@pytest.mark.parametrize("share", [0.2, 0.6, 0.95])
def test_recordings_that_were_cut(tmp_path: Path, share: float) -> None:
    path = recording(tmp_path / "r.mcap")
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    assert "unreadable" in kinds_of(path)


def test_frames_of_a_recording_repeat_go_back_and_jump(tmp_path: Path) -> None:
    times = [START + n * STEP for n in range(20)]
    repeated = [*times[:5], times[4], *times[6:]]
    assert kinds_of(recording(tmp_path / "a.mcap", times=repeated)) == ["losses", "duplicate-time"]
    jumping = [*times[:10], *(t + 10**9 for t in times[10:])]
    assert kinds_of(recording(tmp_path / "b.mcap", times=jumping)) == ["losses", "jump"]


def test_images_that_cannot_be_decoded(tmp_path: Path) -> None:
    image = encode_image(np.full((8, 8), 90, np.uint8), "png", 0)
    broken = bytearray(image)
    broken[40] ^= 1
    images = [image] * 20
    images[3] = images[9] = bytes(broken)
    found = found_in(recording(tmp_path / "r.mcap", images=images))
    assert [(f.kind, f.location, f.n_locations) for f in found if f.kind != "losses"] == [
        ("image", "camera cam1: frame 3", 2)
    ]
    (tmp_path / "f0.png").write_bytes(broken)
    assert kinds_of(tmp_path / "f0.png") == ["image"]


@pytest.mark.parametrize("true_from", [0, START - 20 * STEP, START + 20 * STEP])
def test_truth_of_none_of_the_times_of_a_recording(tmp_path: Path, true_from: int) -> None:
    _, found = found_in(recording(tmp_path / "r.mcap", true_from=true_from))
    assert (found.kind, found.location) == ("truth-disjoint", "/truth, times")
    assert found.value.endswith("; the sensors 2023-11-14T22:13:20.000Z to 2023-11-14T22:13:21.900Z")


@pytest.mark.parametrize("true_from", [START - 19 * STEP, START + 19 * STEP])
def test_truth_that_shares_one_time_with_a_recording(tmp_path: Path, true_from: int) -> None:
    assert kinds_of(recording(tmp_path / "r.mcap", true_from=true_from)) == ["losses"]


def test_rows_of_a_recording(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    with RecordingWriter(path, None, Provenance("test")) as writer:
        writer.table(bearings())
        writer.table(bearings().take(slice(3, 4)))
        channel = writer._channel("/bearings/cam1", "occlog.Bearings", "json")
        writer._add(channel, START, b'{"t_ns": 1.5}', 99)
    assert sorted(kinds_of(path)) == ["duplicate-row", "message"]


@pytest.fixture(scope="module")
def linked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("linked")
    for file in (SAMPLE / "room").iterdir():
        shutil.copy(file, folder)
    return folder


def test_the_sample_is_clean_and_linked_videos_are_looked_at(linked: Path) -> None:
    findings, path = Findings("r"), linked / "recording.mcap"
    seen = {file.resolve() for file in sorted(linked.glob("*.avi"))[1:]}
    check_recording(path, open_recording(path), findings, seen)
    assert list(findings) == []
    assert len(seen) == 4
    assert found_in(linked / "run.yaml") == [Finding("unknown", str(linked / "run.yaml"), "", "")]


def test_linked_videos_that_changed_or_are_gone(linked: Path, tmp_path: Path) -> None:
    shutil.copy(linked / "recording.mcap", tmp_path)
    (tmp_path / "recording.southwest.avi").write_bytes(b"changed")
    found = found_in(tmp_path / "recording.mcap")
    assert [f.kind for f in found] == ["linked-video"] * 4
    assert sum("content changed" in f.value for f in found) == 1


def test_videos_that_were_cut(linked: Path, tmp_path: Path) -> None:
    data = (linked / "recording.southwest.avi").read_bytes()
    (tmp_path / "cut.avi").write_bytes(data[: len(data) // 2])
    found = found_in(tmp_path)
    assert found
    assert {f.kind for f in found} == {"video-frames"}
    (tmp_path / "cut.avi").write_bytes(data[:40])
    assert kinds_of(tmp_path) == ["unreadable"]


OTHERS = {
    "scene.yaml": "occlog_scene: 1\ncameras: 5\n",
    "a.yaml": "x: 2001-99-99\n",
    "a.json": "{",
    "a.xml": "<a>",
    "a.toml": "a = ",
    "a.parquet": "PAR1 and then nothing",
    "a.mcap": "no mark",
    "a.wav": "RIFF____WAVEfmt ",
    "a.mp4": "nothing",
    "empty.csv": "",
}


@pytest.mark.parametrize("name", OTHERS)
def test_files_that_cannot_be_read(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text(OTHERS[name])
    assert kinds_of(tmp_path) == ["unreadable"]


def test_one_damaged_file_does_not_stop_the_others(tmp_path: Path) -> None:
    for name, text in OTHERS.items():
        (tmp_path / name).write_text(text)
    (tmp_path / "notes.xyz").write_text("x")
    found = check_files([tmp_path])
    assert {Path(f.file).name for f in found.findings} == set(OTHERS)
    assert found.others == {".xyz": 1}


def test_the_command_says_it_in_lines_and_in_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    whole, gap = table(tmp_path / "a.parquet"), tmp_path / "b.parquet"
    assert run(["doctor", str(whole)]) == ExitCode.DONE
    assert capsys.readouterr().out == ""
    table(gap, lambda t: t.take([*range(10), *range(20, 40)]))
    assert run(["doctor", str(gap), str(whole)]) == ExitCode.LOSSY
    captured = capsys.readouterr()
    assert captured.out.count("\n") == 1
    assert captured.out.startswith(f"warning: {gap}: sensor cam1: after 2023-11-14T22:13:20.900Z: no data: for 1.1 s")
    assert captured.err == "occlog: 2 files: 1 warning\n"
    (tmp_path / "scene.yaml").write_text("occlog_scene: 2\n")
    assert run(["doctor", str(tmp_path), "--json"]) == ExitCode.BAD_INPUT
    result = json.loads(capsys.readouterr().out)
    Draft202012Validator(finding_schema()).validate(result)
    assert (result["files"], result["errors"], result["warnings"], result["notes"]) == (3, 1, 1, 0)
    assert {f["kind"] for f in result["findings"]} == {"gap", "unreadable"}
    assert run(["doctor", str(tmp_path / "nothing.mcap")]) == ExitCode.BAD_INPUT


def test_a_file_of_an_unknown_kind_is_reported_where_it_was_named(tmp_path: Path) -> None:
    path = tmp_path / "a.xyz"
    path.write_bytes(b"\1\2\3")
    assert kinds_of(path) == ["unknown"]
    assert found_in(tmp_path) == []


def test_every_severity_has_its_exit_code() -> None:
    assert sorted(EXIT_CODES.values()) == [ExitCode.DONE, ExitCode.LOSSY, ExitCode.BAD_INPUT]
    assert {kind.severity for kind in DOCTOR.values()} == set(EXIT_CODES)


def _log(*times: float) -> str:
    rows = "".join(f"{t},{name},{10 * t}\n" for t in times for name in "ab")
    return f"time,sensor,azimuth_deg\n{rows}"


def test_a_clock_that_restarts_is_named_in_tables_of_others(tmp_path: Path) -> None:
    """Rows were put in the order of time before anybody looked."""
    path = tmp_path / "d.csv"
    path.write_text(_log(0, 1, 2, 3, 0.5, 1.5, 2.5))
    (found,) = found_in(path)
    assert (found.kind, found.location, found.n_locations) == ("restart", "line 10", 2)
    assert found.value == "0.5 s after 3 s"
    # One behind another, each in its order; and in no order
    path.write_text("time,id,x,y\n" + "".join(f"{t},{who},{t},1\n" for who in (1, 2) for t in range(6)))
    assert not found_in(path)
    path.write_text(_log(0, 3, 1, 4, 2, 6, 5))
    assert not found_in(path)


def test_names_that_are_lists_are_reported_and_stop_nothing(tmp_path: Path) -> None:
    lists = pa.DictionaryArray.from_arrays(pa.array([0, 0]), pa.array([["a", "b"]]))
    path = tmp_path / "b.arrow"
    for sensor in (lists, pa.array([["a"], ["b"]]), pa.array([{"a": 1}, None])):
        rows = pa.table({"t_ns": [1, 2], "sensor": sensor, "azimuth_deg": [0.0, 1]})
        with pa.ipc.new_file(path, rows.schema) as writer:
            writer.write_table(rows)
        assert any(found.value.endswith("texts were expected") for found in found_in(path))


def test_somebody_in_two_places_is_an_error_as_it_is_to_every_command(tmp_path: Path) -> None:
    one = Truth.of(t_ns=[0], target_id=[1], role=["target"], x=[0.0], y=[0.0], z=[0.0])
    write_table(tmp_path / "t.parquet", Truth.concat([one, replace(one, x=one.x + 1)]), Provenance("test"))
    assert kinds_of(tmp_path / "t.parquet") == ["two-positions"]


def test_a_file_that_is_missing_does_not_stop_the_others(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("a.yaml", "c.yaml"):
        (tmp_path / name).write_text("occlog_scene: 1\nroom: [[0, 0], [1, 0], [0, 0]]\n")
    files = [str(tmp_path / name) for name in ("a.yaml", "b.yaml", "c.yaml")]
    assert run(["doctor", *files]) == ExitCode.BAD_INPUT
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(":")[1].strip() for line in lines] == files
    assert "b.yaml: cannot be read: no such file; did you mean " in lines[1]
    assert run(["doctor", files[1]]) == ExitCode.BAD_INPUT
    assert "occlog: error: " in capsys.readouterr().err
