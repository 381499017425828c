"""Readers, detectors, trackers of one camera, metrics and exporters of packages are used like ours."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner, Result
from detect_scenes import STEP_NS, camera, scene
from packages import install, install_own_parts
from sweep_scene import SCENE
from walk_frames import bearings_frame, stations_frame, truth_frame

import occlog
from occlog.cli.main import cli, run
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import read_provenance, read_table
from occlog.io.files.texts.by_reader import reader_of
from occlog.io.formats.scenes.scene import scene_to_yaml
from occlog.io.recording.writer import RecordingWriter
from occlog.pipeline.run.stages import plan, read_config
from occlog.records.tables import Boxes, Views

BAD = """
import numpy as np
from occlog.plugins.interface import Detected, Settings

class Any:
    summary, settings = "it fails", Settings
    endings, table, units, tables = (".bad",), "bearings", {"a": "1"}, ("tracks",)
    def __init__(self, *given): pass

class Fails(Any):
    def read(self, path): return {}[1]
    def detect(self, image): return 1 / 0
    def step(self, found): raise RuntimeError("no more")
    def figures(self, compared): return int("x")
    def write(self, rows, world, file): file.write(b"begun"); file.seek(0)

class Lies(Any):
    def read(self, path): return {"time": [1, 2], "sensor": ["north"]}
    def detect(self, image): return Detected(np.array([[0, 0, -1, 5]]), np.ones(1))
    def step(self, found): return np.zeros(len(found.boxes), int)
    def figures(self, compared): return {"a": 1.0, "b": 2.0}
    def write(self, rows, world, file): file.write("text")

class Refuses(Any):
    def read(self, path): raise ValueError("line 3: no time")

class NoTables(Any):
    tables = ("trucks",)
    def write(self, rows, world, file): pass
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in which packages are installed, with the measurements of a walk."""
    install_own_parts(tmp_path / "site", monkeypatch)
    (tmp_path / "site/bad_parts.py").write_text(BAD, encoding="utf-8")
    bad = {"fails": "bad_parts:Fails", "lies": "bad_parts:Lies"}
    kinds = ("reader", "detector", "view", "metric", "exporter")
    named = {kind: {f"{name}-{kind}": where for name, where in bad.items()} for kind in kinds}
    named["reader"]["refuses"] = "bad_parts:Refuses"
    named["exporter"] |= {"no-tables": "bad_parts:NoTables", "half": "bad_parts:Lacks"}
    install(tmp_path / "site", "bad-parts", "0.3", named)
    monkeypatch.delitem(sys.modules, "bad_parts", raising=False)
    bearings_frame().to_csv(tmp_path / "bearings.csv", index=False)
    stations_frame().to_csv(tmp_path / "stations.csv", index=False)
    truth_frame().to_csv(tmp_path / "truth.csv", index=False)
    frame = bearings_frame()
    lines = zip(frame.time, frame.station, 90.0 - frame.bearing_deg, strict=True)
    text = "".join(f"{time} {station} {angle!r}\n" for time, station, angle in lines)
    (tmp_path / "walk.compass").write_text(text, encoding="utf-8")
    (tmp_path / "walk.bad").write_text("?", encoding="utf-8")
    return tmp_path


def called(*args: object) -> Result:
    return CliRunner().invoke(cli, [str(a) for a in args])


def done(*args: object) -> dict[str, object]:
    result = called(*args, "--json")
    assert result.exit_code == 0, result.output
    found: dict[str, object] = json.loads(result.stdout)
    return found


def failed(capsys: pytest.CaptureFixture[str], *args: object) -> tuple[int, str]:
    capsys.readouterr()
    code = run([str(a) for a in args])
    stderr = capsys.readouterr().err
    lines = [line for line in stderr.splitlines() if line.startswith("occlog: ") or "rror" in line]
    assert len(lines) == 1, stderr
    return code, stderr


def tracks_of(folder: Path) -> Path:
    done("track", folder / "bearings.csv", "--scene", folder / "stations.csv", "--method", "fix", "-o", folder / "t.pq")
    return folder / "t.pq"


def film(folder: Path, count: int = 8) -> Path:
    """A recording of two cameras with two bright figures each, who walk."""
    room = scene(camera("a", 0.0, 0.0, 45.0), camera("b", 8.0, 0.0, 135.0))
    with RecordingWriter(folder / "film.mcap", room, Provenance("test"), overwrite=True) as out:
        for k in range(count):
            for cam in room.cameras:
                image = np.full((120, 160, 3), 40, dtype=np.uint8)
                image[30:90, 20 + 2 * k : 35 + 2 * k] = 220
                image[35:100, 120 - 2 * k : 138 - 2 * k] = 220
                out.image(cam.name, k * STEP_NS, k, cv2.imencode(".png", image)[1].tobytes(), "png")
    return folder / "film.mcap"


# Readers


def test_a_file_of_a_reader_is_read_like_a_csv_by_its_ending(folder: Path) -> None:
    scene_args = ("--scene", folder / "stations.csv", "--method", "fix")
    done("track", folder / "walk.compass", *scene_args, "-o", folder / "a.pq", "--reader", "compass")
    done("track", folder / "walk.compass", *scene_args, "-o", folder / "b.pq")
    assert (folder / "a.pq").read_bytes() == (folder / "b.pq").read_bytes()
    frame = bearings_frame().assign(id=0, sigma_deg=2.0)
    frame.to_csv(folder / "same.csv", index=False)
    done("track", folder / "same.csv", *scene_args, "-o", folder / "c.pq")
    read, plain = occlog.read(folder / "a.pq"), occlog.read(folder / "c.pq")
    np.testing.assert_allclose(read["x"], plain["x"], atol=1e-9)
    reader = {"file": "walk.compass", "name": "compass", "package": "occlog-own-parts 1.0", "sigma_deg": 2.0}
    assert read.provenance["readers"] == [reader]
    assert "readers" not in plain.provenance
    assert occlog.read(folder / "walk.compass").name == "bearings"


def test_settings_of_a_reader_are_options_under_its_name(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    args = ("--scene", folder / "stations.csv", "--method", "fix", "-o")
    bearings_frame().assign(id=0, sigma_deg=0.5).to_csv(folder / "same.csv", index=False)
    done("track", folder / "walk.compass", *args, folder / "a.pq", "--reader", "compass", "--compass-sigma-deg", 0.5)
    done("track", folder / "same.csv", *args, folder / "b.pq")
    read, plain = occlog.read(folder / "a.pq"), occlog.read(folder / "b.pq")
    np.testing.assert_allclose(read["cov_xx"], plain["cov_xx"], rtol=1e-6)
    assert read.provenance["readers"][0]["sigma_deg"] == 0.5
    args = ("track", folder / "walk.compass", *args)
    shown = called("track", "--reader", "compass", "--help").output
    assert "--compass-sigma-deg" in shown
    assert "Error of the compass." in shown
    assert "--compass-sigma-deg" not in called("track", "--help").output
    code, message = failed(capsys, *args, folder / "c.pq", "--reader", "compass", "--compass-sigma-deg", 0)
    assert (code, "--compass-sigma-deg" in message) == (2, True)
    code, message = failed(capsys, *args, folder / "c.pq", "--reader", "compas")
    assert (code, "did you mean 'compass'" in message) == (2, True)
    code, message = failed(capsys, "info", folder / "bearings.csv", "--reader", "compass")
    assert (code, "no input has a name that ends in .compass" in message) == (2, True)


def test_a_reader_is_used_by_ingest(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = "\n".join(
        (
            "import pandas as pd",
            "from occlog.plugins.interface import Settings",
            "class Log:",
            "    summary, settings, endings, table = 'rows', Settings, ('.rows',), 'boxes'",
            "    def __init__(self, settings): pass",
            "    def read(self, path):",
            "        rows = [line.split() for line in path.read_text().splitlines()]",
            "        names = ('camera', 'frame', 'time', 'left', 'top', 'width', 'height', 'confidence')",
            "        kinds = (str, int, float, float, float, float, float, float)",
            "        return {n: [kind(row[k]) for row in rows] for k, (n, kind) in enumerate(zip(names, kinds))}",
        )
    )
    (folder / "site/row_log.py").write_text(source, encoding="utf-8")
    install(folder / "site", "row-log", "2", {"reader": {"rows": "row_log:Log"}})
    sys.path.append(str(folder))  # another path: metadata are read again
    try:
        rows = [f"cam {k} {0.1 * k:.1f} {10 + k} 20 30 60 0.8" for k in range(5)]
        (folder / "boxes.rows").write_text("\n".join(rows) + "\n", encoding="utf-8")
        args = ("ingest", "-o", folder / "r.mcap", "--boxes", folder / "boxes.rows", "--image-size", "160x120")
        done(*args, "--allow-uncalibrated")
        found = occlog.read(folder / "r.mcap", "boxes")
        assert found["left_px"].tolist() == [10.0, 11.0, 12.0, 13.0, 14.0]
        assert occlog.open(folder / "r.mcap").provenance["readers"][0]["package"] == "row-log 2"
        (folder / "boxes.rows").write_text("\n".join([*rows, "cam 5 0.5 10 20 30 60 1.8"]), encoding="utf-8")
        code, message = failed(capsys, *args, "--allow-uncalibrated", "--overwrite", "-q")
        assert (code, "boxes.rows: row 6: confidence 1.8" in message) == (4, True)
    finally:
        sys.path.remove(str(folder))


def test_a_stage_of_a_run_names_its_reader(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = "\n".join(
        (
            "from dataclasses import dataclass",
            "from occlog.plugins.interface import Settings, setting",
            "@dataclass(frozen=True)",
            "class Own(Settings):",
            "    OWNER = 'lines'",
            "    shift_px: float = setting(0.0, 'Moves boxes to the right.', unit='px')",
            "class Log:",
            "    summary, settings, endings, table = 'lines', Own, ('.txt',), 'boxes'",
            "    def __init__(self, settings): self.shift = settings.shift_px",
            "    def read(self, path):",
            "        frames = [int(line) for line in path.read_text().split()]",
            "        left = [20.0 + 2 * k + self.shift for k in frames]",
            "        boxes = {'left': left * 2, 'top': [30.0] * 10, 'width': [15.0] * 10, 'height': [60.0] * 10}",
            "        return {'camera': ['a'] * 5 + ['b'] * 5, 'frame': frames * 2, 'confidence': [0.9] * 10, **boxes}",
        )
    )
    (folder / "site/line_log.py").write_text(source, encoding="utf-8")
    install(folder / "site", "line-log", "1", {"reader": {"lines": "line_log:Log"}})
    (folder / "boxes.txt").write_text("0\n1\n2\n3\n4\n", encoding="utf-8")
    room = scene(camera("a", 0.0, 0.0, 45.0), camera("b", 8.0, 0.0, 135.0))
    (folder / "room.yaml").write_text(scene_to_yaml(room), encoding="utf-8")
    config = folder / "run.yaml"
    stages = "detect: {scene: nowhere.yaml}\n"  # refused, once the recording is there
    text = "occlog_run: 1\ningest:\n  scene: room.yaml\n  fps: 5\n  boxes: boxes.txt\n  reader: lines\n"
    sys.path.append(str(folder))  # another path: metadata are read again
    try:
        config.write_text(f"{text}  lines_shift_px: 3\n{stages}", encoding="utf-8")
        assert "nowhere.yaml: no such file" in failed(capsys, "run", config, "-o", folder / "out", "-q")[1]
        assert occlog.read(folder / "out/recording.mcap", "boxes")["left_px"][0] == 23.0
        assert reader_of(folder / "boxes.txt") is None  # it holds for its stage alone
        for old, new, reported in (
            ("reader: lines", "reader: line", "line 6: ingest.reader: 'line': no such reader; did you mean 'lines'?"),
            ("reader: lines", "lines_shift_px: 3", "line 6: ingest.lines_shift_px: unknown key"),
            ("reader: lines", "reader: compass", "line 6: ingest.reader: compass: no input has a name that ends in"),
        ):
            config.write_text(text.replace(old, new).replace("boxes: boxes.txt", "boxes: b.csv") + stages)
            (folder / "b.csv").write_text("frame,camera,left,top,right,bottom,confidence\n0,a,20,30,35,90,0.9\n")
            assert run(["run", str(config), "-o", str(folder / "other"), "-q"]) == 4
            lines = capsys.readouterr().err.splitlines()
            assert len(lines) == 1
            assert reported in lines[0]
    finally:
        sys.path.remove(str(folder))


def test_a_reader_that_refuses_or_fails_gives_one_line(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, words in (
        ("refuses", "walk.bad: line 3: no time (reader refuses, bad-parts 0.3)"),
        ("fails-reader", "plug-in fails-reader (bad-parts 0.3): KeyError: 1 at "),
        ("lies-reader", "plug-in lies-reader (bad-parts 0.3): "),
    ):
        code, message = failed(capsys, "info", folder / "walk.bad", "--reader", name)
        assert (code, words in message) == (4, True), message
    code, message = failed(capsys, "info", folder / "walk.bad")
    assert code == 2
    assert "readers fails-reader and lies-reader and refuses" in message


# Exporters


def test_an_exporter_of_others_is_a_format(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tracks = tracks_of(folder)
    found = done("export", tracks, "--to", "gnuplot", "-o", folder / "t.dat")
    assert (found["rows"], found["plugin"], found["format"]) == (40, "occlog-own-parts 1.0", "gnuplot")
    lines = (folder / "t.dat").read_text(encoding="utf-8").splitlines()
    table = occlog.read(tracks)
    assert lines[0] == "# target 7, t [s] x y [m]"
    assert lines[1] == f"0.000000000 {table['x'][0]:.6f} {table['y'][0]:.6f}"
    assert called("export", tracks, "--to", "gnuplot", "-o", "-").stdout == "\n".join(lines) + "\n"
    assert done("export", tracks, "--to", "gnuplot", "-o", folder / "u.dat", "--target", 9)["rows"] == 0
    assert "gnuplot's blocks of t x y" in called("export", "--help").output
    code, message = failed(capsys, "export", folder / "bearings.csv", "--to", "gnuplot", "-o", folder / "v.dat")
    assert (code, "tracks" in message) == (4, True)
    code, message = failed(capsys, "export", tracks, "--to", "gnuplit", "-o", folder / "v.dat")
    assert (code, "did you mean 'gnuplot'" in message) == (2, True)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("fails-exporter", "plug-in fails-exporter (bad-parts 0.3): UnsupportedOperation: seek"),
        ("lies-exporter", "TypeError: an exporter writes bytes, not str; encode the text at "),
        ("no-tables", "plug-in no-tables (bad-parts 0.3): tables: trucks; give "),
        ("half", "plug-in half (bad-parts 0.3): AttributeError: "),
    ],
)
def test_an_exporter_that_fails_gives_one_line_and_no_file(
    folder: Path, capsys: pytest.CaptureFixture[str], name: str, words: str
) -> None:
    code, message = failed(capsys, "export", tracks_of(folder), "--to", name, "-o", folder / "t.dat")
    assert (code, words in message) == (4, True), message
    assert not (folder / "t.dat").exists()


# Metrics


def test_a_metric_of_others_is_a_figure(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tracks = tracks_of(folder)
    args = ("evaluate", tracks, "--truth", folder / "truth.csv", "--metric", "gaps")
    found = done(*args, "-o", folder / "m.json", "--fail-if", "gaps_longest_s>0.6")
    assert (found["gaps_longest_s"], found["gaps_tracks"]) == (0.5, 1.0)
    stored = json.loads((folder / "m.json").read_text(encoding="utf-8"))
    assert stored["gaps_longest_s"] == 0.5
    assert stored["_provenance"]["parameters"]["metrics"] == [{"name": "gaps", "package": "occlog-own-parts 1.0"}]
    assert "gaps_longest_s" in called(*args).output
    assert occlog.evaluate(tracks, folder / "truth.csv", metrics=["gaps"])["gaps_longest_s"] == 0.5
    with pytest.raises(occlog.UsageError, match="gaps has no setting 'x'"):
        occlog.evaluate(tracks, folder / "truth.csv", metrics={"gaps": {"x": 1}})
    assert run([str(a) for a in (*args, "--fail-if", "gaps_longest_s>0.4")]) == 6
    code, message = failed(capsys, *args, "--fail-if", "gaps_shortest_s>0.4")
    assert (code, "did you mean" in message, "gaps_longest_s" in message) == (2, True, True)
    code, message = failed(capsys, *args[:4], "--fail-if", "gaps_longest_s>0.4")
    assert code == 2
    code, message = failed(capsys, "evaluate", tracks, "--bearings", folder / "bearings.csv", "--metric", "gaps")
    assert (code, "--metric is for TRACKS on the ground with --truth" in message) == (2, True)
    for name, words in (
        ("fails-metric", "plug-in fails-metric (bad-parts 0.3): ValueError: invalid literal"),
        ("lies-metric", "plug-in lies-metric (bad-parts 0.3): figures gives b, which units does not declare"),
    ):
        code, message = failed(capsys, *args[:4], "--metric", name)
        assert (code, words in message) == (4, True), message


# Detectors and trackers of one camera


def test_a_detector_of_others_finds_boxes_and_a_tracker_follows_them(folder: Path) -> None:
    recording, views = film(folder), folder / "v.parquet"
    found = done("detect", recording, "--method", "bright", "--bright-threshold", 200, "-o", views)
    assert (found["frames"], found["boxes"], found["plugin"]) == (16, 32, "occlog-own-parts 1.0")
    table = read_table(views, Views)
    first = (table.frame == 0) & (table.sensor == "a")
    edges = np.column_stack([table.left_px, table.top_px, table.width_px, table.height_px])
    np.testing.assert_allclose(edges[first], [[119.5, 34.5, 18.0, 65.0], [19.5, 29.5, 15.0, 60.0]])
    made = read_provenance(views).parameters["detector"]
    assert made == {"name": "bright", "package": "occlog-own-parts 1.0", "threshold": 200, "least_px": 30}
    done("detect", recording, "--method", "bright", "-o", folder / "w.parquet", "--bearings", folder / "b.parquet")
    assert (folder / "b.parquet").is_file()
    same = occlog.detect(recording, method="bright", threshold=200)
    same.views.save(folder / "same.parquet")
    assert (folder / "same.parquet").read_bytes() == views.read_bytes()
    with pytest.raises(occlog.UsageError, match="fuse is not an argument of detector bright; leave it out"):
        occlog.detect(recording, method="bright", fuse=True)
    with pytest.raises(occlog.UsageError, match="has no setting 'treshold'; did you mean 'threshold'"):
        occlog.detect(recording, method="bright", treshold=200)
    assert "--bright-threshold" in called("detect", "--method", "bright", "--help").output
    output = done("track", views, "--method", "overlap", "-o", folder / "boxes.parquet")
    assert (output["identities"], output["frames"], output["skipped"]) == (4, 16, 0)
    boxes = read_table(folder / "boxes.parquet", Boxes)
    for sensor, wanted in (("a", 2), ("b", 2)):
        own = boxes.take(boxes.sensor == sensor)
        assert len(np.unique(own.target_id)) == wanted
        walked = [own.take(own.target_id == k).left_px for k in np.unique(own.target_id)]
        assert sorted(np.diff(left).tolist() for left in walked) == [[-2.0] * 7, [2.0] * 7]
    assert set(boxes.target_id[boxes.sensor == "a"]).isdisjoint(boxes.target_id[boxes.sensor == "b"])
    one = done("track", views, "--method", "overlap", "--cameras", "a", "-o", folder / "one.parquet")
    assert one["cameras"] == ["a"]
    result = occlog.track(views, method="overlap")
    assert result.tracks["target_id"].tolist() == boxes.target_id.tolist()


def test_detectors_and_trackers_that_fail_give_one_line(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording, out = film(folder, 2), folder / "v.parquet"
    for name, words in (
        ("fails-detector", "plug-in fails-detector (bad-parts 0.3): ZeroDivisionError: division by zero at "),
        ("lies-detector", "camera a: frame 0: box 0 is -1 x 5 px; width and height must be above 0"),
    ):
        code, message = failed(capsys, "detect", recording, "--method", name, "-o", out, "-q")
        assert (code, words in message) == (4, True), message
    code, message = failed(capsys, "detect", recording, "--method", "brigth", "-o", out)
    assert (code, "did you mean 'bright'" in message) == (2, True)
    code, message = failed(capsys, "detect", recording, "--method", "bright", "--fuse", "-o", out)
    assert (
        code,
        "--fuse is an option of --method auto, network, background, outlines, components, not of" in message,
    ) == (
        2,
        True,
    )
    assert not out.exists()
    done("detect", recording, "--method", "bright", "-o", out)
    for name, words in (
        ("fails-view", "plug-in fails-view (bad-parts 0.3): RuntimeError: no more at "),
        ("lies-view", "plug-in lies-view (bad-parts 0.3): camera a: frame 0: identity 0 is twice in one frame"),
    ):
        code, message = failed(capsys, "track", out, "--method", name, "-o", folder / "t.parquet", "-q")
        assert (code, words in message) == (4, True), message
    for args, words in (
        (("--window", 1), "takes each frame of a camera by itself"),
        (("--cameras", "c"), "no camera 'c'"),
        (("--diagnostics", "d.parquet"), "--diagnostics"),
    ):
        code, message = failed(capsys, "track", out, "--method", "overlap", *args, "-o", folder / "t.parquet", "-q")
        assert (code, words in message) == (2, True), message
    assert not (folder / "t.parquet").exists()


# All


def test_plug_ins_are_listed_by_kind_and_checked(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = json.loads(called("plugin", "list", "--json").stdout)["plugins"]
    kinds = {each["name"]: each["kind"] for each in result if each["package"] == "occlog-own-parts 1.0"}
    assert kinds == {
        "bright": "detector",
        "compass": "reader",
        "gaps": "metric",
        "gnuplot": "exporter",
        "overlap": "tracker in images",
    }
    assert run(["plugin", "check", "gnuplot"]) == 0
    assert "exporter: 20 checks, 0 faults" in capsys.readouterr().out
    assert run(["plugin", "check", "compass", "--sample", str(folder / "walk.compass")]) == 0
    assert "reader: 22 checks, 0 faults" in capsys.readouterr().out
    code, message = failed(capsys, "plugin", "check", "compass")
    assert (code, "--sample FILE" in message) == (2, True)
    code, message = failed(capsys, "plugin", "check", "gaps", "--sample", folder / "walk.compass")
    assert (code, "--sample is for readers" in message) == (2, True)
    assert run(["plugin", "check", "lies-metric"]) == 6
    assert "figures: figures gives b, which units does not declare" in capsys.readouterr().out


def test_settings_of_a_plug_in_have_a_schema(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = json.loads(called("schema", "bright").stdout)
    assert found["title"] == "plug-in bright (occlog-own-parts 1.0): settings"
    assert found["properties"]["threshold"]["maximum"] == 255
    code, message = failed(capsys, "schema", "brigth")
    assert (code, "did you mean 'bright'" in message) == (2, True)


def test_no_plug_in_is_looked_for_where_all_names_are_ours(folder: Path) -> None:
    calls = [
        [
            "track",
            folder / "bearings.csv",
            "--scene",
            folder / "stations.csv",
            "--method",
            "fix",
            "-o",
            folder / "t.pq",
        ],
        ["export", folder / "t.pq", "-o", folder / "t.csv"],
        ["evaluate", folder / "t.pq", "--truth", folder / "truth.csv"],
    ]
    code = (
        "import importlib.metadata, sys\n"
        "from numba.core.entrypoints import init_all\n"  # numba searches for its own extensions, once
        "init_all()\n"
        "from occlog.cli.main import run\n"
        "def refuse(**given): raise AssertionError('looked for plug-ins')\n"
        "importlib.metadata.distributions = refuse\n"
        f"sys.exit(max(run(call) for call in {[[str(word) for word in call] for call in calls]!r}))"
    )
    made = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert made.returncode == 0, made.stderr


RUN = """
occlog_run: 1
seed: 3
simulate: {scene: room.yaml, steps: 12, occluders: 0}
track: {method: own, sigma_a: 0.5}
evaluate: {metric: gaps}
"""
SWEEP = """
occlog_sweep: 1
scene: room.yaml
runs: 1
simulate: {steps: 8, occluders: 0}
track: {method: own}
vary: {track.sigma_a: [0.5, 5.0]}
"""


def test_methods_and_metrics_of_others_go_through_a_run(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "room.yaml").write_text(SCENE, encoding="utf-8")
    config = folder / "run.yaml"
    config.write_text(RUN, encoding="utf-8")
    assert run(["run", str(config), "-o", str(folder / "out"), "--quiet"]) == 0
    made = read_provenance(folder / "out/tracks.parquet").parameters
    assert (made["method"], made["sigma_a"], made["plugin"]) == ("own", 0.5, "occlog-own-filter 1.0")
    assert "gaps_longest_s" in json.loads((folder / "out/metrics.json").read_text(encoding="utf-8"))
    for old, new, words in (
        ("sigma_a: 0.5", "sigma_b: 0.5", "track.sigma_b: unknown key; did you mean 'sigma_a'?"),
        ("method: own, sigma_a: 0.5", "method: overlap", "method overlap gives boxes with identities"),
        ("metric: gaps", "metric: gap", "evaluate.metric: 'gap': no such metric; did you mean 'gaps'?"),
    ):
        config.write_text(RUN.replace(old, new), encoding="utf-8")
        code, message = failed(capsys, "run", config, "-o", folder / "other", "--quiet", "--dry-run")
        assert (code in (2, 4), words in message) == (True, True), message


def test_a_detector_of_others_goes_through_a_run(folder: Path) -> None:
    config = folder / "run.yaml"
    config.write_text(
        f"occlog_run: 1\nrecording: {film(folder, 2).name}\ndetect: {{method: bright, bright_threshold: 200}}\n"
        "track: {method: fix}\n",
        encoding="utf-8",
    )
    made = list(plan(read_config(config), folder / "out"))
    values = made[0].values
    assert [v for name, v in values.items() if name.endswith("threshold")] == [200]
    assert str(values["output"]).endswith("views.parquet")
    assert str(values["bearings"]).endswith("bearings.parquet")


def test_methods_of_others_go_through_a_sweep(folder: Path) -> None:
    (folder / "room.yaml").write_text(SCENE, encoding="utf-8")
    (folder / "sweep.yaml").write_text(SWEEP, encoding="utf-8")
    assert run(["sweep", str(folder / "sweep.yaml"), "-o", str(folder / "s"), "--workers", "1", "-q"]) == 0
    lines = (folder / "s/summary.csv").read_text(encoding="utf-8").splitlines()
    found = {line.split(",")[0]: line.split(",")[3] for line in lines if ",rmse," in line}
    assert set(found) == {"0.5", "5.0"}
    assert len(set(found.values())) == 2
