"""The zoo: broken and hostile files, each with the exit code and the words that its reader must answer with."""

from __future__ import annotations

import ast
import json
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from mcap.writer import Writer
from places import ROOT

from occlog.cli.main import DEBUG, LazyGroup, run
from occlog.errors import ExitCode
from occlog.io.files.limits import MAX_CONFIGURATION_BYTES

SCENE = """occlog_scene: 1
room: [[0, 0], [8, 0], [8, 6], [0, 6]]
cameras:
- {name: a, position: [0, 0, 1.5], yaw_deg: 40, focal_px: 60, image_size_px: [64, 48]}
- {name: b, position: [8, 0, 1.5], yaw_deg: 140, focal_px: 60, image_size_px: [64, 48]}
"""
SIMULATE = ("simulate", "{file}", "-o", "new.mcap", "--steps", "3")
TRACK = ("track", "{file}", "--scene", "scene.yaml", "-o", "new.parquet", "--particles", "5")
INFO = ("info", "{file}")
BOXES = ("ingest", "--boxes", "a={file}", "--scene", "scene.yaml", "--fps", "10", "-o", "new.mcap")
BOXED = ("ingest", "--boxes", "a=boxes.csv", "--scene", "scene.yaml", "-q", "-o", "new.mcap", "--fps", "10")
TIMED = (*BOXED[:-2], "--timestamps")
CALIBRATE = ("ingest", "--boxes", "a=boxes.csv", "--calibration", "{file}", "--fps", "10", "-o", "new.mcap")
REPORT = ("report", "t.parquet", "--scene", "scene.yaml", "--metrics", "{file}", "-o", "new.html")


class Case(NamedTuple):
    """A kind of file: its name, how it is made, what reads it, and words of the one line that comes of it."""

    name: str
    make: Callable[[Path], object]
    command: tuple[str, ...]
    words: str


def text(content: str) -> Callable[[Path], object]:
    return lambda path: path.write_text(content, encoding="utf-8")


def metadata(key: bytes, value: bytes) -> Callable[[Path], object]:
    """A good table of which one entry of the footer is another."""

    def make(path: Path) -> None:
        table = pq.read_table(path.parent / "b.parquet")
        pq.write_table(table.replace_schema_metadata({**table.schema.metadata, key: value}), path)

    return make


def changed(column: str, values: pa.Array) -> Callable[[Path], object]:
    """A good table of which one column has other values."""

    def make(path: Path) -> None:
        table = pq.read_table(path.parent / "b.parquet")
        many = pa.concat_arrays([values] * len(table))
        place = table.schema.get_field_index(column)
        field = pa.field(column, values.type, nullable=False)
        pq.write_table(table.set_column(place, field, many).replace_schema_metadata(table.schema.metadata), path)

    return make


def recorded(data: bytes, schema: str = "occlog.Bearings", topic: str = "/bearings/a") -> Callable[[Path], object]:
    """A recording of one message."""

    def make(path: Path) -> None:
        with path.open("wb") as file:
            writer = Writer(file)
            writer.start()
            known = writer.register_schema(schema, "jsonschema", b"{}")
            writer.add_message(writer.register_channel(topic, "json", known), 1, data, 1)
            writer.finish()

    return make


def bearing(**values: object) -> Callable[[Path], object]:
    """A recording of one bearing, good but for some values."""
    good = {"t_ns": 1, "sensor": "a", "target_id": [0], "seen": [True], "bearing": [0.1], "sigma": [0.01]}
    good |= {name: [None] for name in ("u_px", "sigma_px", "score")}
    return recorded(json.dumps({**good, **values}).encode())


LAUGHS = "a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]\n" + "".join(
    f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]\n" for n in range(1, 8)
)
VALUES = ("2001-99-99", "!!int abc", "!!int 0b", "!!float abc", "!!bool foo", "!!timestamp foo", "9" * 5000)
MADE = b"occlog.provenance"
CASES = [
    *[Case(f"yaml value {v[:16]}", text(f"{SCENE}x: {v}\n"), SIMULATE, "line 6") for v in VALUES],
    Case("yaml list as key", text(f"{SCENE}? [a, b]\n: 1\n"), SIMULATE, "cannot be a key"),
    Case("yaml mapping as key", text(f"{SCENE}? {{a: 1}}\n: 1\n"), SIMULATE, "cannot be a key"),
    Case("yaml surrogate", text(SCENE.replace("name: a", r'name: "\ud800"')), SIMULATE, "line 4: not valid YAML"),
    Case("yaml entries", text(f"{SCENE}x: [{'1,' * 500_000}]"), SIMULATE, "more than 200000 entries"),
    Case("yaml depth", text("[" * 1500), SIMULATE, "nested too deeply"),
    Case("yaml laughs", text(LAUGHS), SIMULATE, "aliases expanded"),
    Case("yaml that holds itself", text(f"{SCENE}x: &x [*x]\n"), SIMULATE, "aliases expanded"),
    Case("yaml size", text(SCENE + "#" * MAX_CONFIGURATION_BYTES), SIMULATE, "of at most"),
    Case("yaml unknown tag", text(f"{SCENE}x: !!python/object:os.system 1\n"), SIMULATE, "line 6"),
    Case("json depth", text("[" * 100_000), REPORT, "nested too deeply"),
    Case("json digits", text(f'{{"rmse_m": {"9" * 5000}}}'), REPORT, "cannot be read"),
    Case("json surrogate", text('{"camera": "\\ud800"}'), REPORT, "half of a surrogate pair"),
    Case("json list", text("[1]"), REPORT, "expected a JSON object"),
    Case("json not utf-8", lambda p: p.write_bytes(b'{"a": "\xff"}'), REPORT, "not UTF-8"),
    Case("boxes depth", text("[" * 100_000), BOXES, "nested too deeply"),
    Case("boxes digits", text(f"[{'9' * 5000}]"), BOXES, "cannot be read"),
    Case("opencv laughs", text("%YAML:1.0\n---\nk: !!opencv-matrix\n" + LAUGHS), CALIBRATE, "aliases"),
    Case("opencv aliases", text("%YAML:1.0\n---\n" + LAUGHS + "k: !!opencv-matrix {}\n"), CALIBRATE, "aliases"),
    Case("opencv depth", text("%YAML:1.0\n---\nk: !!opencv-matrix " + "[" * 1500), CALIBRATE, "nested too deeply"),
    Case("opencv json list", text('{"k": "opencv-matrix"' + "}" * 2), CALIBRATE, "not valid JSON"),
    Case(
        "opencv rows",
        text(
            "<opencv_storage><k type_id='opencv-matrix'><rows>³</rows><cols>3</cols><data>1 0 0 0 1 0 0 0 1</data></k>"
            "<rvec>0 0 0</rvec><tvec>0 0 0</tvec></opencv_storage>"
        ),
        CALIBRATE,
        "expected a 3 x 3 camera matrix",
    ),
    Case("xml entities", text('<!DOCTYPE a [<!ENTITY b "c">]><opencv_storage>opencv-&b;'), CALIBRATE, "entities"),
    Case("provenance list", metadata(MADE, b"[1]"), TRACK, "provenance"),
    Case("provenance flip", metadata(MADE, b'{"command": "det'), TRACK, "provenance"),
    Case("provenance bytes", metadata(MADE, b"\xff\xfe\x00"), TRACK, "provenance"),
    Case("provenance loss", metadata(MADE, b'{"command": "x", "parameters": {}, "losses": [1]}'), TRACK, "damaged"),
    Case("message of no JSON", recorded(b"{'t_ns': 1}"), TRACK, "not a message of occlog.Bearings"),
    Case("message that is a list", recorded(b"[1]"), TRACK, "not a message of occlog.Bearings"),
    Case("message of nothing", recorded(b""), TRACK, "not a message of occlog.Bearings"),
    Case("message depth", recorded(b'{"x": ' + b"[" * 100_000), TRACK, "not a message of occlog.Bearings"),
    Case("message without a time", recorded(b'{"sensor": "a"}'), TRACK, "not a message of occlog.Bearings"),
    *[
        Case(f"message of {name} {json.dumps(value)}", bearing(**{name: value}), TRACK, words)
        for name, value, words in (
            ("t_ns", 1.5, "Expected `int`"),
            ("t_ns", True, "Expected `int`"),
            ("t_ns", "1", "Expected `int`"),
            ("t_ns", 10**30, "t_ns"),
            ("sensor", [1], "Expected `str`"),
            ("sensor", None, "Expected `str`"),
            ("bearing", 0.1, "Expected `array"),
            ("bearing", ["0.1"], "Expected `float"),
            ("bearing", [[0.1]], "Expected `float"),
            ("bearing", [None], "row 0: seen is True but bearing is nan"),
            ("bearing", [0.1, 0.2], "not a message of"),
            ("bearing", [float("nan")], "not a message of"),
            ("target_id", [0.5], "Expected `int`"),
            ("target_id", [10**12], "column target_id"),
        )
    ],
    Case("image of 1e20 px", text(SCENE.replace("[64, 48]", "[100000000000000000000, 48]")), SIMULATE, "<= 100000"),
    Case("image of -1 px", text(SCENE.replace("[64, 48]", "[-1, 48]")), SIMULATE, ">= 1, got -1"),
    Case("clock of 1e20 ns", text(f"{SCENE}clocks:\n- {{name: a, offset_ns: {10**20}}}\n"), SIMULATE, "offset_ns"),
    Case("camera named ..", text(SCENE.replace("name: a", "name: ..")), SIMULATE, "cameras[0].name"),
    Case("camera named by an escape", text(SCENE.replace("name: a", 'name: "\\e[2J"')), SIMULATE, "cameras[0].name"),
    Case(
        "target below -1", changed("target_id", pa.array([-7], pa.int32())), TRACK, "target_id -7 must be at least -1"
    ),
    Case("times as dates", changed("t_ns", pa.array([7], pa.timestamp("us"))), TRACK, "column t_ns is timestamp[us]"),
    Case("sidecar without a row", text("time\n"), (*TIMED, "a={file}"), "holds a header and no row"),
    Case("truth without a row", text("t,x,y\n"), (*BOXED, "--truth", "{file}"), "holds a header and no row"),
    Case("info of provenance list", metadata(MADE, b"[1]"), INFO, "provenance"),
    *[
        Case(f"{kind} as {command[0]}", make, command, words)
        for kind, make, words in (
            ("pipe", os.mkfifo, "is a pipe"),
            ("device", lambda p: p.symlink_to("/dev/zero"), "is a device"),
            ("link to itself", lambda p: p.symlink_to(p), "cannot be read"),
            ("link to nothing", lambda p: p.symlink_to(p.parent / "nothing"), "no such file"),
        )
        for command in (SIMULATE, TRACK, BOXES, CALIBRATE, REPORT)
    ],
]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a good scene, bearings and boxes."""
    folder = tmp_path_factory.mktemp("zoo")
    (folder / "scene.yaml").write_text(SCENE)
    (folder / "boxes.csv").write_text("frame,left,top,width,height\n0,1,2,3,4\n")
    for name, short in (("bearings", "b"), ("tracks", "t")):
        shutil.copy(ROOT / f"tests/golden/expected/simulated/{name}.parquet", folder / f"{short}.parquet")
    return folder


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_what_cannot_be_read_is_one_line(
    case: Case, made: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(made)
    file = made / f"cage{'.parquet' if case.command[0] == 'track' else '.yaml'}"
    case.make(file)
    before = sorted(made.iterdir())
    code = run([word.format(file=file.name) for word in case.command])
    stderr = capfd.readouterr().err.splitlines()
    assert sorted(made.iterdir()) == before
    file.unlink()
    assert code == ExitCode.BAD_INPUT, stderr
    assert len(stderr) == 1, stderr
    assert file.name in stderr[0]
    assert case.words in stderr[0]


TOML = [
    ("dotted key", ".".join(["a"] * 20_000) + " = 1\n"),
    ("table name", "[" + ".".join(["a"] * 50_000) + "]\n"),
    ("digits", "matrix = " + "9" * 5000),
    ("depth", "a = " + "[" * 5000),
    ("key without a value", "[cam]\nmatrix\n"),
]


@pytest.mark.parametrize(("name", "content"), TOML, ids=[name for name, _ in TOML])
def test_toml_that_cannot_be_read_is_one_line(
    name: str, content: str, made: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(made)
    file = made / "cage.toml"
    file.write_text(content)
    code = run([word.format(file=file.name) for word in CALIBRATE] + ["--calibration-format", "opencv-toml"])
    stderr = capfd.readouterr().err.splitlines()
    assert code == ExitCode.BAD_INPUT, stderr
    assert len(stderr) == 1, stderr
    assert "cage.toml" in stderr[0]


def test_times_of_another_program_are_described(
    made: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(made)
    changed("t_ns", pa.array([7], pa.timestamp("us")))(made / "dates.parquet")
    assert run(["info", "dates.parquet"]) == ExitCode.DONE
    stdout = capsys.readouterr().out
    assert "table bearings" in stdout
    assert "\ntime " not in stdout


def test_an_image_of_many_pixels_in_a_recording_is_not_decoded(tmp_path: Path) -> None:
    from occlog.errors import InputError
    from occlog.io.files.provenance import Provenance
    from occlog.io.recording.reader import open_recording
    from occlog.io.recording.writer import RecordingWriter

    data = cv2.imencode(".png", np.zeros((4, 4), np.uint8))[1].tobytes()
    with RecordingWriter(tmp_path / "r.mcap", None, Provenance("test")) as writer:
        writer.image("a", 10**9, 0, data[:16] + (30_000).to_bytes(4, "big") * 2 + data[24:], "png")
        writer.image("a", 10**9 + 1, 1, data.replace(b"IDAT", b"IDAT\0\0"), "png")
    large, flipped = open_recording(tmp_path / "r.mcap").frames()
    with pytest.raises(InputError, match="30000 x 30000 px; the limit is"):
        large.decode()
    with pytest.raises(InputError, match="wrong check sum of PNG part"):
        flipped.decode()


def test_a_bug_says_that_it_is_one_and_what_to_send(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError("of\ntwo lines")

    monkeypatch.setattr(LazyGroup, "invoke", broken)
    monkeypatch.delenv(DEBUG, raising=False)
    assert run(["info", "x"]) == ExitCode.BUG
    (line,) = capfd.readouterr().err.splitlines()
    assert "a bug of occlog" in line
    assert "ZeroDivisionError: of two lines" in line
    assert DEBUG in line
    monkeypatch.setenv(DEBUG, "1")
    with pytest.raises(ZeroDivisionError):
        run(["info", "x"])


BORDER = {
    "json.loads": {
        "files/texts/documents.py",
        "files/provenance.py",
        "files/tables/parquet.py",
        "frames/decoders/process.py",
        "frames/decoders/process_main.py",
        "messages/kinds.py",
    },
    "json.load": set(),
    "yaml.load": set(),
    "yaml.safe_load": set(),
    "yaml.safe_load_all": set(),
    "yaml.compose": {"files/texts/yaml.py"},
    "tomllib.loads": {"files/texts/documents.py"},
    "tomllib.load": set(),
    "ElementTree.fromstring": {"files/texts/documents.py"},
    "ElementTree.parse": set(),
    "ElementTree.iterparse": {"files/texts/documents.py"},
    "cv2.imdecode": {"frames/codec.py"},
    "cv2.imread": set(),
    "cv2.FileStorage": set(),
    "pq.ParquetFile": set(),
    "pq.read_metadata": {"files/tables/parquet.py"},
    "SizedFile": {"files/tables/parquet.py"},
    "open_parquet": {"files/tables/parquet.py", "external/source.py"},
    "sqlite3.connect": {"messages/sqlite_file.py"},
}
"""Every parser of foreign bytes, and the modules that may call it: each points at sizes, and turns what it raises."""


LIBRARIES = {
    "import csv": {
        "errors.py",
        "io/files/texts/by_reader.py",
        "io/files/texts/csv_rows.py",
        "papers/run.py",
        "pipeline/csv_text.py",
    },
    "import gzip": {"io/files/texts/csv_rows.py", "examine/export/run.py"},  # which writes
    "import lz4": {"io/messages/rosbag1_file.py", "io/recording/chunks.py", "io/recording/salvage/records.py"},
    "import mmap": {f"io/video/{name}.py" for name in ("avi", "container", "mkv", "mp4", "reader")}
    | {"io/formats/models/onnx_file.py"}
    | {"io/frames/decoders/memory.py"},  # of images that were decoded
    "import pickle": {"track/people/reidentification.py", "conformance/faults.py"},  # of the process itself
    "import sqlite3": {"io/messages/sqlite_file.py"},
    "import tomllib": {"io/files/texts/documents.py"},
    "import wave": set(),
    "import yaml": {"io/files/texts/yaml.py", "io/formats/scenes/scene.py"} | {"pipeline/start/run.py"},  # which write
    "import zipfile": {"io/formats/calibration/readers/arrays.py", "pipeline/pack/archive.py"},
    "import tarfile": set(),
    "import zstandard": {f"io/recording/{name}.py" for name in ("chunks", "mcap_errors", "salvage/records")}
    | {"io/messages/bag.py", "io/messages/mcap_file.py"},
    "from xml": {f"io/formats/calibration/readers/{name}.py" for name in ("qualisys", "tsai")}
    | {"io/files/texts/documents.py", "io/formats/truth.py"}
    | {"io/formats/boxes/annotations.py"},  # the kind of what is read
    "from scipy.io": set(),
    "from google.protobuf": {"io/messages/kinds.py", "io/recording/reader.py", "examine/viewers/series.py"},
    "np.load(": {"io/formats/calibration/readers/arrays.py"},
    "np.genfromtxt(": set(),
    "np.loadtxt(": set(),
    "zlib.decompress": {"io/formats/calibration/readers/arrays.py"},
}
"""What stands in a module that takes foreign bytes apart, and all modules of the program in which it stands."""


def test_no_library_is_used_next_to_the_border() -> None:
    root = ROOT / "occlog"
    texts = {path.relative_to(root).as_posix(): path.read_text(encoding="utf-8") for path in root.rglob("*.py")}
    found = {}
    for mark in LIBRARIES:
        stands = re.compile(re.escape(mark) if mark.startswith(("np.", "zlib.")) else rf"^\s*{mark}\b", re.MULTILINE)
        found[mark] = {name for name, text in texts.items() if stands.search(text)}
    assert found == LIBRARIES


def test_no_parser_is_called_next_to_the_border() -> None:
    root = ROOT / "occlog" / "io"
    found: dict[str, set[str]] = {name: set() for name in BORDER}
    last = {name.rpartition(".")[2] for name in BORDER}
    for path in root.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(text)) if any(name in text for name in last) else ():
            # Writing an expression as text takes time: only where the name may be one of these
            if isinstance(node, ast.Call) and getattr(node.func, "attr", getattr(node.func, "id", "")) in last:
                name = ast.unparse(node.func)
                if name in found:
                    found[name].add(path.relative_to(root).as_posix())
    assert found == BORDER
