"""`occlog ground` on files: places, summary, evaluation of what came out, one-line errors."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from epipolar_rigs import looking
from view_scenes import TICK, view_tracks, walks

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import describe, read_provenance, read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.scenes.scene import scene_to_yaml
from occlog.io.recording.writer import RecordingWriter
from occlog.records.declared.views import ViewTracks
from occlog.records.losses import Loss
from occlog.records.scene import Scene
from occlog.records.tables import Tracks, Truth

PLACES = {"a": (7.0, 0, 2.5), "b": (0, 7.0, 2.5), "c": (-5.0, -5, 3)}
SCENE = Scene(cameras=tuple(looking(n, np.array(p), (0, 0, 1), 500.0) for n, p in PLACES.items()))
STEPS, WALKS = 100, walks(100)
MADE = Provenance("track", {}, 1)


@pytest.fixture
def folder(tmp_path):
    unplaced = replace(SCENE, cameras=(*SCENE.cameras[:2], replace(SCENE.cameras[2], placed=False)))
    for name, made in (("scene", SCENE), ("unplaced", unplaced), ("own", replace(SCENE, length_unit="unit"))):
        (tmp_path / f"{name}.yaml").write_text(scene_to_yaml(made))
    rows = view_tracks(SCENE.cameras, WALKS, np.random.default_rng(0))
    write_table(tmp_path / "views.parquet", rows, MADE)
    write_table(tmp_path / "one.parquet", rows.take(rows.sensor == "a"), MADE)
    write_table(tmp_path / "none.parquet", ViewTracks.empty(), MADE)
    t_ns = np.repeat(np.arange(STEPS) * TICK, 2)
    truth = Truth.of(
        t_ns=t_ns,
        target_id=np.tile(np.arange(2, dtype=np.int32), STEPS),
        role=np.full(2 * STEPS, "target"),
        x=WALKS[:, :, 0].ravel(),
        y=WALKS[:, :, 1].ravel(),
        z=WALKS[:, :, 2].ravel(),
    )
    write_table(tmp_path / "truth.parquet", truth, MADE)
    with RecordingWriter(tmp_path / "walk.mcap", SCENE, MADE) as writer:
        writer.table(truth)
    return tmp_path


def ground(folder, *args):
    return run(["ground", *(str(folder / a) if a.endswith((".parquet", ".yaml", ".mcap")) else a for a in args)])


def test_tracks_come_out_and_are_as_good_as_they_say(folder, capsys):
    assert ground(folder, "views.parquet", "--scene", "walk.mcap", "-o", "tracks.parquet", "--json") == ExitCode.DONE
    result = json.loads(capsys.readouterr().out)
    assert result["rows"] == result["times"] - result["not_triangulated"]["inconsistent"]
    assert (result["targets"], result["times"], result["views"]["3"]) == ([0, 1], 200, 200 - result["skipped"])
    made = read_provenance(folder / "tracks.parquet")
    assert (made.command, made.parameters["target_height"], made.parameters["centre_error_share"]) == (
        "ground",
        0.9,
        0.25,
    )
    assert describe(folder / "tracks.parquet")["length_unit"] == "m"

    exact = ["views.parquet", "--scene", "scene.yaml", "-o", "exact.parquet", "--set", "centre_error_share=0"]
    assert ground(folder, *exact) == ExitCode.DONE
    capsys.readouterr()
    args = ["evaluate", f"{folder}/exact.parquet", "--truth", f"{folder}/truth.parquet", "--scene"]
    assert run([*args, f"{folder}/scene.yaml", "--json"]) == ExitCode.DONE
    result = json.loads(capsys.readouterr().out)
    # 200 places: a standard error of 0.17 of a mean of 3
    assert result["nees_space_mean"] == pytest.approx(3.0, abs=0.6)
    assert result["rmse_space_m"] < 0.06


def test_cameras_heights_and_what_was_lost(folder, capsys):
    def report_of(*args):
        capsys.readouterr()
        assert ground(folder, *args, "-o", "t.parquet", "--overwrite", "--json") == ExitCode.DONE
        return json.loads(capsys.readouterr().out)

    assert set(report_of("views.parquet", "--scene", "scene.yaml", "--cameras", "a,c")["views"]) == {"2"}
    assert report_of("views.parquet", "--scene", "unplaced.yaml", "--cameras", "a,b")["rows"] > 190
    alone = report_of("one.parquet", "--scene", "scene.yaml", "--set", "target_height=0.8")
    assert alone["views"] == {"1": 200}
    assert np.allclose(read_table(folder / "t.parquet", Tracks).z, 0.8)
    rows = read_table(folder / "views.parquet", ViewTracks)
    losses = (Loss("a", "frame 3", "damaged", 1),)
    write_table(folder / "lossy.parquet", rows, replace(MADE, losses=losses))
    args = ["lossy.parquet", "--scene", "scene.yaml", "-o", "l.parquet"]
    assert ground(folder, *args) == ExitCode.DONE
    assert read_provenance(folder / "l.parquet").losses == losses


def test_frames_are_brought_together_as_when_they_were_tracked(folder, capsys):
    rows = view_tracks(SCENE.cameras, WALKS, np.random.default_rng(0), delay_ns=4_000_000)
    for name, window_ns in (("told", 19_000_000), ("untold", None)):
        write_table(folder / f"{name}.parquet", rows, replace(MADE, parameters={"window_ns": window_ns}))

    def views(*args):
        capsys.readouterr()
        base = ["--scene", "scene.yaml", "-o", "t.parquet", "--overwrite", "--json"]
        assert ground(folder, *args, *base) == ExitCode.DONE
        return json.loads(capsys.readouterr().out)["views"]

    assert views("told.parquet").keys() <= {"2", "3"}
    assert views("untold.parquet").keys() == {"1"}
    assert views("told.parquet", "--window", "0").keys() == {"1"}
    assert views("untold.parquet", "--window", "0.01").keys() <= {"2", "3"}


@pytest.mark.parametrize(
    ("args", "code", "says"),
    [
        (["views.parquet"], ExitCode.USAGE, "holds no scene; give one with --scene"),
        (["views.parquet", "--scene", "unplaced.yaml"], ExitCode.BAD_INPUT, "camera c has no pose"),
        (["views.parquet", "--scene", "scene.yaml", "--cameras", "a,z"], ExitCode.USAGE, "the scene has a, b, c"),
        (
            ["views.parquet", "--scene", "scene.yaml", "--set", "target_hight=1"],
            ExitCode.USAGE,
            "did you mean 'target_height'",
        ),
        (
            ["views.parquet", "--scene", "scene.yaml", "--set", "false_rejection_probability=2"],
            ExitCode.USAGE,
            "false_rejection_probability=2: must be above 0 and below 1",
        ),
        (
            ["views.parquet", "--scene", "scene.yaml", "--set", "target_height=nan"],
            ExitCode.USAGE,
            "height=nan: must be finite",
        ),
        (["views.parquet", "--scene", "scene.yaml", "--window", "nan"], ExitCode.USAGE, "nan is not a finite number"),
        (["one.parquet", "--scene", "own.yaml"], ExitCode.BAD_INPUT, "has a position at any time (single view 200)"),
        (["none.parquet", "--scene", "scene.yaml"], ExitCode.BAD_INPUT, "has no rows of the cameras in use"),
        (["truth.parquet", "--scene", "scene.yaml"], ExitCode.BAD_INPUT, "truth.parquet"),
        (["walk.mcap", "--scene", "scene.yaml"], ExitCode.BAD_INPUT, "is a recording; give view tracks"),
        (["missing.parquet", "--scene", "scene.yaml"], ExitCode.BAD_INPUT, "missing.parquet"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(folder, capsys, args, code, says):
    assert ground(folder, *args, "-o", "x.parquet") == code
    error = capsys.readouterr().err.strip()
    assert says in error
    assert "\n" not in error
    assert not (folder / "x.parquet").exists()
