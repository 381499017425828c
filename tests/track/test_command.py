"""`occlog track` on files: inputs of every kind, options, exit codes, one-line errors."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from field_log import logs, rounds
from tracker_scenes import SECOND, observe, room100, walk, with_array

from occlog.cli.main import run
from occlog.errors import ExitCode, InputError, UsageError
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import describe, read_provenance, read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.scenes.scene import scene_to_yaml
from occlog.io.recording.reader import open_recording
from occlog.io.recording.writer import RecordingWriter
from occlog.records.losses import Loss
from occlog.records.tables import UNLABELLED, Bearings, Calibration, Diagnostics, Doa, Tracks
from occlog.track.run import one_at_a_time, parse_start

pytestmark = pytest.mark.jit

SCENE = with_array(room100(pillar=False), (50.0, 50.0), sigma=0.05)
MADE = Provenance("detect", losses=(Loss("cam1", "frame 7", "cut", 1),))
STEPS = 12


def bearings(targets=(0,)):
    parts = []
    for k in targets:
        rng = np.random.default_rng([1, k])
        parts.append(observe(room100(pillar=False), walk(STEPS, rng), rng, target=k))
    return Bearings.merge(parts)


def doa():
    path = walk(STEPS, np.random.default_rng([1, 0]))
    return Doa.of(
        t_ns=np.arange(STEPS) * SECOND,
        sensor=["array"] * STEPS,
        source_id=np.full(STEPS, -1, dtype=np.int32),
        azimuth=np.arctan2(path[:, 1] - 50, path[:, 0] - 50),
        elevation=np.full(STEPS, np.nan),
        sigma_azimuth=np.full(STEPS, np.nan),
        sigma_elevation=np.full(STEPS, np.nan),
        confidence=np.full(STEPS, np.nan),
    )


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "scene.yaml").write_text(scene_to_yaml(SCENE))
    write_table(tmp_path / "bearings.parquet", bearings((0, 3)), MADE)
    with RecordingWriter(tmp_path / "room.mcap", SCENE, MADE) as writer:
        writer.table(bearings())
        writer.table(doa())
    return tmp_path


def track(folder, *args, source="bearings.parquet"):
    """Exit code of the command with few particles; outputs are `tracks.parquet` and `diagnostics.parquet`."""
    return run(
        [
            "track",
            str(folder / source),
            "-o",
            str(folder / "tracks.parquet"),
            "-q",
            "--particles",
            "100",
            "--diagnostics",
            str(folder / "diagnostics.parquet"),
            *args,
        ]
    )


def with_scene(folder, *args):
    return track(folder, "--scene", str(folder / "scene.yaml"), *args)


def test_bearings_become_tracks_and_diagnostics(folder, capsys):
    assert with_scene(folder, "--json", "--seed", "4") == ExitCode.DONE  # the detector had lost a frame
    captured = capsys.readouterr()
    summary = json.loads(captured.out)
    assert (summary["targets"], summary["rows"], summary["method"]) == (2, 2 * STEPS, "apf")
    assert 1 <= summary["mean_effective_sample_size"] <= 100
    assert summary["lost_earlier"][0]["place"] == "frame 7"
    tracks = read_table(folder / "tracks.parquet", Tracks)
    diagnostics = read_table(folder / "diagnostics.parquet", Diagnostics)
    assert len(tracks) == len(diagnostics) == 2 * STEPS
    provenance = read_provenance(folder / "tracks.parquet")
    assert provenance.command == "track"
    assert provenance.seed == 4
    assert provenance.parameters["particles"] == 100
    assert [name for name, _ in provenance.inputs] == ["bearings.parquet", "scene.yaml"]
    assert provenance.losses == MADE.losses
    assert describe(folder / "tracks.parquet")["length_unit"] == "unit"


def test_errors_of_the_cameras_are_written_where_they_are_estimated(folder, capsys):
    found = folder / "calibration.parquet"
    joint = ("--set", "calibrate=joint", "--calibration", str(found))
    assert with_scene(folder, *joint) == ExitCode.DONE
    table = read_table(found, Calibration)
    assert len(table) == 2 * STEPS * 9  # targets, times, sensors
    assert set(table.sensor.tolist()) == {*(f"cam{i}" for i in range(1, 9)), "array"}
    assert np.all(table.sd_dx[table.sensor == "array"] == 0.0)
    assert np.all(table.sd_dx[table.sensor == "cam1"] > 0.0)
    assert read_provenance(found).parameters["calibrate"] == "joint"
    capsys.readouterr()
    assert with_scene(folder, "--calibration", str(found), "--overwrite") == ExitCode.USAGE
    assert "add --set calibrate=joint or --set calibrate=initial" in capsys.readouterr().err


def test_a_recording_brings_its_scene_and_its_directions_of_arrival(folder):
    assert track(folder, source="room.mcap") == ExitCode.DONE
    diagnostics = read_table(folder / "diagnostics.parquet", Diagnostics)
    assert set(diagnostics.cameras.tolist()) == {",".join([*(f"cam{i}" for i in range(1, 9)), "array"])}
    assert set(diagnostics.target_id.tolist()) == {0}


def test_directions_of_arrival_of_another_file_can_be_added(folder):
    write_table(folder / "doa.parquet", doa(), Provenance("ingest"))
    assert with_scene(folder, "--doa", str(folder / "doa.parquet"), "--target", "0") == ExitCode.DONE
    assert read_table(folder / "diagnostics.parquet", Diagnostics).cameras[0].endswith("cam8,array")
    assert "doa.parquet" in dict(read_provenance(folder / "tracks.parquet").inputs)


def test_the_same_seed_gives_the_same_file(folder):
    with_scene(folder, "--seed", "5")
    first = (folder / "tracks.parquet").read_bytes()
    with_scene(folder, "--seed", "5", "--overwrite")
    assert (folder / "tracks.parquet").read_bytes() == first
    with_scene(folder, "--seed", "6", "--overwrite")
    assert (folder / "tracks.parquet").read_bytes() != first


def test_sensors_and_targets_can_be_chosen(folder):
    with_scene(folder, "--cameras", "cam1, cam3,cam5", "--without", "cam3", "--target", "3")
    diagnostics = read_table(folder / "diagnostics.parquet", Diagnostics)
    assert set(diagnostics.cameras.tolist()) == {"cam1,cam5"}
    assert set(diagnostics.target_id.tolist()) == {3}


def test_a_track_without_labels_begins_at_the_start(folder):
    rows = bearings()
    values = {c.name: getattr(rows, c.name) for c in Bearings.columns()}
    values["target_id"] = np.full(len(rows), UNLABELLED, dtype=np.int32)
    write_table(folder / "boxes.parquet", Bearings(**values), Provenance("detect"))
    first = walk(STEPS, np.random.default_rng([1, 0]))[0]
    start = f"{first[0]},{first[1]},0.1"
    args = ("--scene", str(folder / "scene.yaml"), "--start", start, "--target", "7")
    assert track(folder, *args, source="boxes.parquet") == ExitCode.DONE
    tracks = read_table(folder / "tracks.parquet", Tracks)
    assert set(tracks.target_id.tolist()) == {7}
    assert np.hypot(tracks.x[0] - first[0], tracks.y[0] - first[1]) < 0.2
    nothing = track(folder, *args, "--labelled-only", "--overwrite", source="boxes.parquet")
    assert nothing == ExitCode.BAD_INPUT


def test_sensors_in_turn_are_a_network_without_overlap(folder):
    alone = ("--cameras", "cam5,cam2,cam1", "--target", "0", "--round-robin", "3")
    assert with_scene(folder, *alone) == ExitCode.DONE
    found = read_table(folder / "diagnostics.parquet", Diagnostics)
    want = ["cam1"] * 3 + ["cam2"] * 3 + ["cam5"] * 3 + ["cam1"] * 3  # in the order of the scene
    assert found.cameras.tolist() == want
    assert set(found.n_observing.tolist()) == {1}
    parameters = read_provenance(folder / "tracks.parquet").parameters
    assert (parameters["in_turn_s"], parameters["doa_labels"]) == (3.0, False)


def test_microphone_arrays_have_turns_too(folder):
    assert track(folder, "--round-robin", "1", "--cameras", "cam1,array", source="room.mcap") == ExitCode.DONE
    assert read_table(folder / "diagnostics.parquet", Diagnostics).cameras.tolist() == ["cam1", "array"] * (STEPS // 2)


def test_cameras_without_a_pose_have_no_turn():
    rows, everyone = bearings(), frozenset(f"cam{i}" for i in range(1, 9))
    known = rows.take((rows.sensor == "cam1") | (rows.sensor == "cam3"))
    cameras = tuple(c if c.name in ("cam1", "cam3") else replace(c, placed=False) for c in SCENE.cameras)
    found = Bearings.concat(list(one_at_a_time([known], replace(SCENE, cameras=cameras), everyone, 1.0)))
    assert found.sensor.tolist() == ["cam1", "cam3"] * (STEPS // 2)
    with pytest.raises(InputError, match="row 1: camera 'cam2' has no pose"):
        list(one_at_a_time([rows], replace(SCENE, cameras=cameras), everyone, 1.0))
    with pytest.raises(UsageError, match="no sensor with a pose is left"):
        one_at_a_time([rows], replace(SCENE, cameras=cameras), frozenset({"cam2"}), 1.0)


def test_a_row_of_an_unknown_sensor_is_named_with_its_number_in_turns_too(folder, capsys):
    rows = bearings()
    names = rows.sensor.copy()
    names[47] = "cam9"  # the last of its time, and so in the file
    write_table(folder / "odd.parquet", replace(rows, sensor=names), Provenance("detect"))
    args = ("--scene", str(folder / "scene.yaml"), "--round-robin", "2")
    assert track(folder, *args, source="odd.parquet") == ExitCode.BAD_INPUT
    assert "bearings: row 47: no sensor 'cam9' in the scene" in capsys.readouterr().err


def test_directions_of_arrival_can_be_labelled(folder, capsys):
    log = replace(doa(), source_id=np.full(STEPS, 3, dtype=np.int32))
    write_table(folder / "doa.parquet", log, Provenance("ingest"))
    args = ("--doa", str(folder / "doa.parquet"), "--target", "0", "--target", "3")
    assert with_scene(folder, *args, "--doa-labels") == ExitCode.DONE
    rows = read_table(folder / "diagnostics.parquet", Diagnostics)
    assert all("array" in c for c in rows.cameras[rows.target_id == 3].tolist())
    assert not any("array" in c for c in rows.cameras[rows.target_id == 0].tolist())
    assert read_provenance(folder / "tracks.parquet").parameters["doa_labels"] is True
    write_table(folder / "doa.parquet", doa(), Provenance("ingest"), overwrite=True)
    capsys.readouterr()
    assert with_scene(folder, *args, "--doa-labels", "--overwrite") == ExitCode.BAD_INPUT
    error = capsys.readouterr().err
    assert f"doa: none of {STEPS} directions has an identity (source_id)" in error
    assert error.count("\n") == 1


def test_the_animal_of_a_field_log_is_followed_by_its_number(shared_data, tmp_path, capsys):
    """783 bearings of an animal in 276 rounds: the filter is near the least-squares crossings (median 37 m)."""
    data = shared_data / "telemetr_bearings"
    field, tracks = str(tmp_path / "field.mcap"), str(tmp_path / "tracks.parquet")
    assert run(["ingest", "-o", field, *logs(data), "-q"]) == ExitCode.DONE
    capsys.readouterr()
    assert (
        run(["track", field, "-o", tracks, "-q", "--doa-labels", "--labelled-only", "--json", "--particles", "300"])
        == ExitCode.DONE
    )
    assert json.loads(capsys.readouterr().out)["rows"] == rounds(data)
    found, log = read_table(tmp_path / "tracks.parquet", Tracks), open_recording(tmp_path / "field.mcap")
    assert set(found.target_id.tolist()) == {340}
    towers = {a.name: a.position[:2] for a in log.scene.arrays}
    heard, away = log.read(Doa), []
    for t_ns, x, y in zip(found.t_ns, found.x, found.y, strict=True):
        rows = heard.take(heard.t_ns == t_ns)
        normal = np.column_stack([-np.sin(rows.azimuth), np.cos(rows.azimuth)])
        right = np.array([n @ towers[s] for n, s in zip(normal, rows.sensor.tolist(), strict=True)])
        away.append(np.hypot(*(np.linalg.lstsq(normal, right, rcond=None)[0] - [x, y])))
    assert np.median(away) < 60
    assert run(["track", field, "-o", tracks, "-q", "--labelled-only", "--overwrite"]) == ExitCode.BAD_INPUT


def test_settings_go_to_the_method(folder):
    with_scene(folder, "--set", "process_noise_position=0.7", "--set", "detection_probability=0.9")
    parameters = read_provenance(folder / "tracks.parquet").parameters
    assert (parameters["process_noise_position"], parameters["detection_probability"]) == (0.7, 0.9)


@pytest.mark.parametrize(
    ("args", "code", "message"),
    [
        (
            ["--cameras", "cam0"],
            ExitCode.USAGE,
            "no sensor 'cam0' in the scene, to be used or omitted; did you mean 'cam",
        ),
        (
            ["--without", ",".join([*(f"cam{i}" for i in range(1, 9)), "array"])],
            ExitCode.USAGE,
            "all sensors are omitted",
        ),
        (["--set", "sigma_v=1"], ExitCode.USAGE, "did you mean 'process_noise_position'?"),
        (["--set", "sigma_v"], ExitCode.USAGE, "--set sigma_v: expected NAME=VALUE"),
        (["--set", "velocity_memory=2"], ExitCode.USAGE, "--set velocity_memory=2: must be at least 0 and at most 1"),
        (["--start", "1"], ExitCode.USAGE, "--start 1: expected X,Y or X,Y,SIGMA"),
        (["--start", "1,2", "--set", "start=1,2,3"], ExitCode.USAGE, "give one of them"),
        (["--start", "1,2"], ExitCode.USAGE, "choose one target, e.g. --target 3"),
        (["--target", "5"], ExitCode.BAD_INPUT, "no row is of the chosen targets and sensors"),
        (["--doa", "bearings.parquet"], ExitCode.USAGE, "is an input too"),
        (["--method", "kalman"], ExitCode.USAGE, "apf"),
        (["--particles", "0"], ExitCode.USAGE, "--particles"),
        (["--round-robin", "0"], ExitCode.USAGE, "--round-robin"),
        (["--round-robin", "nan"], ExitCode.USAGE, "--round-robin': nan is not a finite number"),
        (["--doa-labels"], ExitCode.USAGE, "--doa-labels requires directions of arrival; give some (--doa)"),
    ],
)
def test_what_cannot_be_done_is_one_line_and_leaves_no_output(folder, capsys, monkeypatch, args, code, message):
    monkeypatch.chdir(folder)
    if "--doa" in args:
        args = [*args, "--diagnostics", "bearings.parquet"]
    assert with_scene(folder, *args) == code
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (folder / "tracks.parquet").exists()
    assert not (folder / "diagnostics.parquet").exists()


def test_a_scene_is_needed_with_a_table(folder, capsys):
    assert track(folder) == ExitCode.USAGE
    assert "give one with --scene" in capsys.readouterr().err


def test_files_that_are_missing_damaged_or_of_another_kind_are_refused(folder, capsys):
    (folder / "cut.parquet").write_bytes((folder / "bearings.parquet").read_bytes()[:-40])
    (folder / "empty.parquet").write_bytes(b"")
    write_table(folder / "none.parquet", Bearings.empty(), Provenance("detect"))
    with RecordingWriter(folder / "blank.mcap", SCENE, Provenance("ingest")):
        pass
    scene = ["--scene", str(folder / "scene.yaml")]
    for name in ("missing.parquet", "cut.parquet", "empty.parquet", "none.parquet", "blank.mcap"):
        assert track(folder, *scene, source=name) == ExitCode.BAD_INPUT
        error = capsys.readouterr().err
        assert name in error
        assert error.count("\n") == 1
    assert not (folder / "tracks.parquet").exists()


def test_outputs_that_exist_are_kept(folder, capsys):
    (folder / "tracks.parquet").write_text("precious")
    assert with_scene(folder) == ExitCode.EXISTS
    assert (folder / "tracks.parquet").read_text() == "precious"
    assert "--overwrite" in capsys.readouterr().err


def test_bearings_that_contradict_each_other_are_refused(folder, capsys):
    rows = bearings()
    copy = rows.take(np.flatnonzero(rows.sensor == "cam2")[3:4])
    other = replace(copy, bearing=copy.bearing + 0.1)
    for row, words in (
        (copy, "a row is repeated (t_ns 3000000000, sensor cam2, target_id 0)"),
        (other, "sensor 'cam2' has two rows of target 0 at 3 s"),
    ):
        write_table(folder / "twice.parquet", Bearings.merge([rows, row]), Provenance("detect"), overwrite=True)
        assert track(folder, "--scene", str(folder / "scene.yaml"), source="twice.parquet") == ExitCode.BAD_INPUT
        assert words in capsys.readouterr().err


def test_a_start_without_sigma_is_half_a_metre_in_any_unit():
    assert parse_start("1,2", "m") == "1,2,0.5"
    assert float(parse_start("1,2", "ft").split(",")[2]) == pytest.approx(0.5 / 0.3048)
    assert parse_start("1,2", "unit") == "1,2,1.0"
    assert parse_start("1,2,3", "m") == "1,2,3"


def test_importing_the_command_loads_nothing_heavy():
    code = "import sys, occlog.track.catalogue; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"numpy", "pyarrow", "cv2", "numba", "pandas"} & set(done.stdout.split())
