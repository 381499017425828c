"""Texts and headers of other programs that are wrong: each is one line with the file and what was expected."""

from __future__ import annotations

import gzip
import struct
from pathlib import Path
from typing import NamedTuple

import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode

SCENE = """occlog_scene: 1
room: [[0, 0], [8, 0], [8, 6], [0, 6]]
cameras:
- {name: a, position: [0, 0, 1.5], yaw_deg: 40, focal_px: 60, image_size_px: [64, 48]}
"""
BOXES = "frame,left,top,width,height\n"
GOOD = f"{BOXES}0,1,2,3,4\n"
INGEST = "ingest --boxes a=good.csv --scene scene.yaml -q -o new.mcap"
COMMANDS = {
    "boxes": "ingest --boxes a={file} --scene scene.yaml --fps 10 -q -o new.mcap",
    "times": f"{INGEST} --timestamps a={{file}}",
    "truth": f"{INGEST} --fps 10 --truth {{file}}",
    "calibration": "ingest --boxes a=good.csv --calibration {file} --fps 10 -q -o new.mcap",
    "run": "run {file} -o new",
    "sweep": "sweep {file} -o new",
    "table": "track {file} --scene scene.yaml -q -o new.parquet",
    "sound": "listen --arrays mics.csv mics={file} -o new.parquet -q",
}


class Kind(NamedTuple):
    """What reads a file, its name, its content, and words of the line that comes of it."""

    command: str
    file: str
    content: str | bytes
    words: str


def head_of_npy(text: str) -> bytes:
    return b"\x93NUMPY\1\0" + struct.pack("<H", 70) + text.ljust(69).encode() + b"\n"


def wav(form: bytes | None, data: bytes | None = bytes(64), kind: bytes = b"WAVE") -> bytes:
    parts = [(name, part) for name, part in ((b"fmt ", form), (b"data", data)) if part is not None]
    body = b"".join(name + struct.pack("<I", len(part)) + part for name, part in parts)
    return b"RIFF" + struct.pack("<I", 4 + len(body)) + kind + body


def form(tag: int = 1, channels: int = 3, rate: int = 8000, bits: int = 16) -> bytes:
    return struct.pack("<HHIIHH", tag, channels, rate, rate * channels * bits // 8, channels * bits // 8, bits)


SWEEP = "occlog_sweep: 1\nscene: scene.yaml\nseed: 1\nruns: 1\nsimulate: {steps: 3}\ntrack: {particles: VALUE}\n"
MCAP = b"\x89MCAP0\r\n"
KINDS = {
    "header twice": Kind("boxes", "c.csv", BOXES * 2, "line 2: a second header line"),
    "open quote": Kind("boxes", "c.csv", BOXES + '0,"1,2,3,4\n', "line 2: 2 cells"),
    "nul": Kind("boxes", "c.csv", BOXES + "0,1,2\0,3,4\n", "line 2: not text"),
    "inf": Kind("boxes", "c.csv", BOXES + "0,inf,2,3,4\n", "line 2: box that reaches to inf px"),
    "negative frame": Kind("boxes", "c.csv", BOXES + "-1,1,2,3,4\n", "frame -1 is before the first one, 0"),
    "half a frame": Kind("boxes", "c.csv", BOXES + "1.5,1,2,3,4\n", "a whole number"),
    "negative width": Kind("boxes", "c.csv", BOXES + "0,1,2,-3,4\n", "both must be above 0"),
    "few cells": Kind("boxes", "c.csv", BOXES + "0,1,2\n", "3 cells, but the first line has 5"),
    "long line": Kind("boxes", "c.csv", BOXES + "1" * 1_000_001, "longer than 1000000 characters"),
    "latin": Kind("boxes", "c.csv", (BOXES + "é").encode("latin-1"), "not UTF-8 text"),
    "utf-16": Kind("boxes", "c.csv", GOOD.encode("utf-16")[:-1], "not UTF-8 text"),
    "superscript": Kind("boxes", "c.csv", BOXES + "0,²,2,3,4\n", "left is '²'; a number"),
    "column twice": Kind("boxes", "c.csv", "frame,left,left,width,height\n0,1,2,3,4\n", "are both read as 'left'"),
    "decimal comma": Kind("boxes", "c.csv", "frame;left;top;width;height\n0;1,5;2;3;4\n", "a decimal comma"),
    "gzip cut": Kind("boxes", "c.csv", gzip.compress(GOOD.encode())[:30], "damaged gzip file"),
    "gzip flip": Kind("boxes", "c.csv", b"\x1f\x8b\x08" + bytes(7) + b"\xff" * 5, "damaged gzip file"),
    "mot frame 0": Kind("boxes", "m.txt", "0,1,10,20,12,30,0.9,-1,-1,-1\n", "frame 0 is before the first one, 1"),
    "coco empty": Kind("boxes", "c.json", "[]", "no row with a box"),
    "coco text": Kind("boxes", "c.json", '[{"image_id": 1, "bbox": "x", "score": 1}]', "bbox is x"),
    "coco three": Kind("boxes", "c.json", '[{"image_id": 1, "bbox": [1, 2, 3], "score": 1}]', "expected [left, top"),
    "coco inf": Kind("boxes", "c.json", '[{"image_id": 1e400, "bbox": [1, 2, 3, 4], "score": 1}]', "a number was"),
    "times back": Kind("times", "t.csv", "time\n2\n1\n", "line 3: time stamp goes back"),
    "time nan": Kind("times", "t.csv", "time\nnan\n", "is missing"),
    "time large": Kind("times", "t.csv", "time\n1e30\n", "too large for seconds"),
    "time of a 99th month": Kind("times", "t.csv", "time\n2001-99-99T00:00:00\n", "month must be in 1..12"),
    "times empty": Kind("times", "t.csv", "", "is empty (0 bytes)"),
    "truth nan": Kind("truth", "g.csv", "t,x,y\n0,nan,1\n", "x is missing"),
    "truth text": Kind("truth", "g.csv", "t,x,y\n0,a,1\n", "a number was expected"),
    "truth without y": Kind("truth", "g.csv", "t,x\n0,1\n", "has no column y"),
    "truth depth": Kind("truth", "g.geojson", "[" * 100_000, "not ground truth of a known format"),
    "xml number": Kind("truth", "g.xml", '<dataset><frame number="x"/></dataset>', "a finite number"),
    "xml cut": Kind("truth", "g.xml", "<dataset><frame", "line 1: not XML"),
    "zero matrix": Kind("calibration", "a_P.txt", "0 0 0 0\n" * 3, "cannot be inverted"),
    "nan matrix": Kind("calibration", "a_P.txt", "nan 0 0 0\n" * 3, "four finite ones were expected"),
    "npz of text": Kind("calibration", "k.npz", b"PK\3\4hello", "cannot be read as arrays"),
    "npy cut": Kind("calibration", "k.npy", head_of_npy("{'descr': 'O', (")[:40], "cannot be read as arrays"),
    "npy open": Kind("calibration", "k.npy", head_of_npy("{'descr': 'O', ("), "cannot be read as arrays"),
    "npy of objects": Kind(
        "calibration",
        "k.npy",
        head_of_npy("{'descr': '|O8', 'fortran_order': False, 'shape': (3,)}"),
        "Object arrays cannot be loaded",
    ),
    "mat of text": Kind("calibration", "k.mat", b"hello" * 40, "not a MATLAB file"),
    "mat 7.3": Kind("calibration", "k.mat", b"\x89HDF\r\n\x1a\n", "MATLAB file of version 7.3"),
    "sweep of a list": Kind("sweep", "s.yaml", SWEEP.replace("VALUE", "[a]"), "must be a whole number"),
    "sweep of a mapping": Kind("sweep", "s.yaml", SWEEP.replace("VALUE", "{a: 1}"), "must be a whole number"),
    "sweep of a date": Kind("sweep", "s.yaml", SWEEP.replace("VALUE", "2001-01-01"), "must be a whole number"),
    "run of a list": Kind("run", "r.yaml", "[]", "expected keys and values"),
    "run depth": Kind("run", "r.yaml", "[" * 1000, "nested too deeply"),
    "run of nothing": Kind("run", "r.yaml", "occlog_run: 1\nseed: 1\n", "give exactly one of recording"),
    "run of tomorrow": Kind("run", "r.yaml", "occlog_run: 99\n", "the version of this format"),
    "parquet marks": Kind("table", "p.parquet", b"PAR1" * 4, "damaged or not a Parquet file"),
    "mcap mark": Kind("table", "p.mcap", MCAP, "truncated: the MCAP end mark is missing"),
    "mcap marks": Kind("table", "p.mcap", MCAP * 4, "truncated: the MCAP end mark is missing"),
    "arrow mark": Kind("table", "p.arrow", b"ARROW1\0\0", "damaged or not a"),
    "arrow stream": Kind("table", "p.arrow", b"\xff" * 7 + b"\x7f", "damaged or not a"),
    "text": Kind("table", "p.txt", "hello\n", "is text without a header line"),
    "database": Kind("table", "p.db3", b"SQLite format 3\0" + bytes(100), "is a database (SQLite), perhaps a bag"),
    "wav of text": Kind("sound", "w.wav", b"hello", "is not a WAV file"),
    "wav that is avi": Kind("sound", "w.wav", wav(form(), kind=b"AVI "), "is not a WAV file"),
    "wav without a format": Kind("sound", "w.wav", wav(None), "has no format"),
    "wav without samples": Kind("sound", "w.wav", wav(form(), None), "has no samples"),
    "wav format cut": Kind("sound", "w.wav", wav(b"\1\0"), "is cut off"),
    "wav of no channel": Kind("sound", "w.wav", wav(form(channels=0)), "0 channels at 8000 Hz"),
    "wav of 0 Hz": Kind("sound", "w.wav", wav(form(rate=0)), "3 channels at 0 Hz"),
    "wav of 12 bits": Kind("sound", "w.wav", wav(form(bits=12)), "with 12 bits"),
    "wav of mp3": Kind("sound", "w.wav", wav(form(tag=0x55)), "samples of format 85"),
    "wav empty": Kind("sound", "w.wav", wav(form(), b""), "holds no sound"),
}


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_a_wrong_file_is_one_line_and_leaves_nothing(
    kind: Kind, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("scene.yaml").write_text(SCENE)
    Path("good.csv").write_text(GOOD)
    Path("mics.csv").write_text("x,y,z\n0,0,1\n0.1,0,1\n0,0.1,1\n")
    Path(kind.file).write_bytes(kind.content if isinstance(kind.content, bytes) else kind.content.encode())
    before = sorted(tmp_path.iterdir())
    code = run(COMMANDS[kind.command].format(file=kind.file).split())
    stderr = capfd.readouterr().err.splitlines()
    assert code == ExitCode.BAD_INPUT, stderr
    assert len(stderr) == 1, stderr
    assert kind.file in stderr[0]
    assert kind.words in stderr[0]
    assert sorted(tmp_path.iterdir()) == before
