"""`occlog fuse` and `occlog detect --fuse` on files: both do the same, and bad input is one line."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from tracker_scenes import room100

from occlog.cli.main import run
from occlog.core.geometry.camera import wrap_angle
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import read_provenance, read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.scenes.scene import scene_to_yaml
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Tracks

pytestmark = pytest.mark.jit


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A simulated recording with misses and false reports, in a room of units."""
    folder = tmp_path_factory.mktemp("fuse")
    (folder / "scene.yaml").write_text(scene_to_yaml(room100(pillar=False)))
    options = ["--steps", "40", "--miss-probability", "0.2", "--false-alarm-probability", "0.1", "--seed", "4", "-q"]
    assert run(["simulate", str(folder / "scene.yaml"), "-o", str(folder / "walk.mcap"), *options]) == ExitCode.DONE
    return folder / "walk.mcap"


def test_detect_and_fuse_do_the_same(recording, tmp_path, capsys):
    one, two, plain = tmp_path / "one.parquet", tmp_path / "two.parquet", tmp_path / "plain.parquet"
    assert run(["detect", str(recording), "-o", str(plain), "-q"]) == ExitCode.DONE
    capsys.readouterr()
    assert (
        run(["detect", str(recording), "-o", str(one), "--fuse", "--false-alarm-probability", "0.1", "--json"])
        == ExitCode.DONE
    )
    fusion = json.loads(capsys.readouterr().out)["fusion"]
    fuse = ["fuse", str(plain), "--scene", str(recording), "-o", str(two), "--false-alarm-probability", "0.1", "--json"]
    assert run(fuse) == ExitCode.DONE
    summary = json.loads(capsys.readouterr().out)
    a, b = read_table(one, Bearings), read_table(two, Bearings)
    for name in ("t_ns", "sensor", "seen", "cause"):
        assert np.array_equal(getattr(a, name), getattr(b, name))
    assert np.array_equal(a.bearing, b.bearing, equal_nan=True)
    assert fusion["cameras"] == summary["cameras"]
    for cause in ("kept", "recovered"):
        assert (
            summary[cause] == np.count_nonzero(b.cause == cause) == sum(c[cause] for c in summary["cameras"].values())
        )
    assert summary["recovered"] > 0
    assert np.count_nonzero(b.seen) > np.count_nonzero(read_table(plain, Bearings).seen)
    assert read_provenance(two).parameters["false_alarm_probability"] == 0.1
    assert read_provenance(one).parameters["fusion"]["false_alarm_probability"] == 0.1


@pytest.mark.parametrize(("degrees", "seed"), [(0, 1), (15, 2), (-15, 3)])
def test_a_camera_that_is_turned_has_its_detections_removed_and_is_named(tmp_path, degrees, seed):
    """Clean rooms and false detections as they are stated; then the camera that sees most, turned."""
    (tmp_path / "scene.yaml").write_text(scene_to_yaml(room100(pillar=False)))
    walk, turned, fused = tmp_path / "walk.mcap", tmp_path / "turned.parquet", tmp_path / "fused.parquet"
    options = [
        "--steps",
        "150",
        "--miss-probability",
        "0.1",
        "--false-alarm-probability",
        "0.1",
        "--seed",
        str(seed),
        "-q",
    ]
    assert run(["simulate", str(tmp_path / "scene.yaml"), "-o", str(walk), *options]) == ExitCode.DONE
    assert run(["detect", str(walk), "-o", str(turned), "-q"]) == ExitCode.DONE
    rows = read_table(turned, Bearings)
    names, counts = np.unique(rows.sensor[rows.seen], return_counts=True)
    crooked = str(names[np.argmax(counts)])
    off = np.where(rows.sensor == crooked, np.radians(degrees), 0.0)
    write_table(turned, replace(rows, bearing=wrap_angle(rows.bearing + off)), Provenance("test"), overwrite=True)
    assert run(["fuse", str(turned), "--scene", str(walk), "-o", str(fused), "-q"]) == ExitCode.DONE
    (verdict,) = [each for each in read_provenance(fused).judged if each.stage == "fuse"]
    reported = [(check.id, check.sensors) for check in verdict.checks if check.found]
    assert reported == ([("many-detections-rejected", (crooked,))] if degrees else [])
    assert verdict.plausible is (not degrees)


def test_tracks_take_recovered_rows_as_not_seen_unless_stated_otherwise(recording, tmp_path):
    fused = tmp_path / "fused.parquet"
    assert run(["fuse", str(recording), "-o", str(fused), "-q"]) == ExitCode.DONE
    rows = read_table(fused, Bearings)
    undone = rows.take(rows.cause != "recovered")
    assert len(undone) < len(rows)
    base = ["track", str(fused), "--scene", str(recording), "--particles", "200", "-q"]
    found = {}
    for name, more in (("ignore", []), ("use", ["--use-recovered"])):
        assert run([*base, "-o", str(tmp_path / f"{name}.parquet"), *more]) == ExitCode.DONE
        found[name] = read_table(tmp_path / f"{name}.parquet", Tracks)
    assert not np.array_equal(found["ignore"].x, found["use"].x)
    assert "use_recovered" not in read_provenance(tmp_path / "ignore.parquet").parameters
    assert read_provenance(tmp_path / "use.parquet").parameters["use_recovered"] is True


def line(capsys) -> str:
    text = capsys.readouterr().err.strip()
    assert "Traceback" not in text
    return text.splitlines()[-1]


def test_bad_input_is_one_line(recording, tmp_path, capsys):
    out = str(tmp_path / "out.parquet")
    scene = room100(pillar=False)
    lone = tmp_path / "lone.yaml"
    lone.write_text(scene_to_yaml(Scene(cameras=scene.cameras[:1], room=scene.room, length_unit="unit")))
    assert run(["fuse", str(recording), "--scene", str(lone), "-o", out]) == ExitCode.BAD_INPUT
    assert "1 camera with a pose; fusion needs at least two" in line(capsys)
    assert run(["detect", str(recording), "--scene", str(lone), "-o", out, "--fuse"]) == ExitCode.BAD_INPUT
    assert "fusion needs at least two" in line(capsys)
    assert run(["detect", str(recording), "-o", out, "--miss-probability", "0.1"]) == ExitCode.USAGE
    assert "--miss-probability is an option of the fusion; add --fuse" in line(capsys)
    assert run(["fuse", str(recording), "-o", out, "--false-alarm-probability", "0"]) == ExitCode.USAGE
    assert run(["fuse", str(recording), "-o", out, "--fused-views", out + "v"]) == ExitCode.USAGE
    assert "--fused-views requires the views" in line(capsys)
    assert run(["fuse", str(tmp_path / "no.parquet"), "--scene", str(recording), "-o", out]) == ExitCode.BAD_INPUT
    assert not (tmp_path / "out.parquet").exists()


def test_frames_that_never_come_together_are_pointed_out(recording, tmp_path, capsys):
    one = tmp_path / "one.parquet"
    assert run(["detect", str(recording), "-o", str(one), "-q"]) == ExitCode.DONE
    rows = read_table(one, Bearings)
    first = rows.take(rows.sensor == "cam1")
    write_table(tmp_path / "first.parquet", first, read_provenance(one), length_unit="unit")
    capsys.readouterr()
    out = str(tmp_path / "out.parquet")
    assert run(["fuse", str(tmp_path / "first.parquet"), "--scene", str(recording), "-o", out]) == ExitCode.DONE
    assert "only one camera delivered a frame; bring frames" in capsys.readouterr().err
