"""Files that commands are given by mistake: what they are, and what to do with them."""

from __future__ import annotations

from pathlib import Path

import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode, InputError
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.io.files.texts.csv_rows import LONGEST_LINE, first_line
from occlog.io.open import open_input
from occlog.io.recording.reader import open_recording
from occlog.records.tables import Tracks, Truth


@pytest.mark.parametrize(
    ("head", "words"),
    [
        (
            b"\0\0\0\x18ftypmp42",
            "is a video .MP4.; make a recording of it by `occlog ingest -o OUT.mcap --video CAMERA=",
        ),
        (b"RIFF\0\0\0\0AVI LIST", "is a video .AVI."),
        (b"<dataset name='S2L1'>", "is XML; true boxes and calibrations in XML go into a recording"),
        (b"<?xml version='1.0'?><dataset/>", "is XML; true boxes and calibrations in XML go into a recording"),
        (b"RIFF\0\0\0\0WAVEfmt ", "is sound .WAV.; find directions in it by `occlog listen`"),
    ],
)
def test_a_video_and_sound_are_reported_where_they_go(tmp_path: Path, head: bytes, words: str) -> None:
    path = tmp_path / "file.bin"
    path.write_bytes(head + bytes(100))
    with pytest.raises(InputError, match=words):
        open_input(path)
    with pytest.raises(InputError, match=words):
        open_recording(path)


def test_json_is_no_damaged_parquet(tmp_path: Path) -> None:
    (tmp_path / "coco.json").write_text('{"images": [], "annotations": []}')
    with pytest.raises(InputError, match="is JSON; boxes in it go into a recording by `occlog ingest --boxes"):
        open_input(tmp_path / "coco.json")


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("t.jsonl", b'{"time": 0, "id": 1, "x": 1, "y": 2}\n', "is JSON; .* write other rows as CSV"),
        ("t.xlsx", b"PK\x03\x04" + bytes(60), "is a ZIP archive, as of Excel or NumPy; save a sheet as CSV"),
        ("t.xls", b"\xd0\xcf\x11\xe0" + bytes(60), "is a file of Excel; save its sheet as CSV"),
        ("t.h5", b"\x89HDF\r\n" + bytes(60), "is HDF5, .*; write its rows as Parquet or CSV"),
        ("t.mat", b"MATLAB 5.0 MAT-file" + bytes(60), "is a file of MATLAB; write its rows as CSV"),
        ("t.pkl", b"\x80\x04\x95" + bytes(60), "is a pickle of Python.*write its rows as Parquet or CSV"),
    ],
)
def test_tables_of_other_programs_are_refused_by_name(tmp_path: Path, name: str, content: bytes, words: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=words):
        open_input(tmp_path / name)


@pytest.mark.parametrize("args", [["track"], ["ingest"]])
def test_a_stream_of_odas_is_reported_where_it_goes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], args: list[str]
) -> None:
    (tmp_path / "sst.json").write_text('{"timeStamp": 1, "src": [{"id": 1, "x": 1, "y": 0, "z": 0, "activity": 1}]}\n')
    assert run([*args, str(tmp_path / "sst.json"), "-o", str(tmp_path / "out.x")]) == ExitCode.BAD_INPUT
    assert "is a stream of directions (ODAS); make a recording of it by `occlog ingest --doa" in capsys.readouterr().err


def test_tracks_in_place_of_the_truth_may_be_swapped(tmp_path: Path) -> None:
    write_table(tmp_path / "tracks.parquet", Tracks.empty(), Provenance("test"))
    with pytest.raises(InputError, match="holds tracks; expected truth; are the files of tracks and truth swapped"):
        open_input(tmp_path / "tracks.parquet", Truth)


def test_a_line_may_have_a_million_characters(tmp_path: Path) -> None:
    path = tmp_path / "long.csv"
    path.write_text("a" * (LONGEST_LINE - 1) + "\n")
    assert len(first_line(path, "a table")[0]) == LONGEST_LINE - 1
    path.write_text("a" * (LONGEST_LINE + 1))
    with pytest.raises(InputError, match="line 1: longer than 1000000 characters"):
        first_line(path, "a table")
