"""`occlog track --method map` on the command line: from a simulation to a report, options, one-line errors."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from places import EXAMPLES
from tracker_scenes import observe, room100

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import describe, read_provenance, read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.models.motion_models import read_motion
from occlog.io.formats.scenes.scene import scene_to_yaml
from occlog.io.recording.reader import open_recording
from occlog.records.tables import UNLABELLED, Bearings, Diagnostics, Occluders, Residuals, Tracks, Truth

pytestmark = pytest.mark.jit

EXAMPLE = EXAMPLES / "room100.yaml"
STEPS = 40
NAMES = ("x", "y", "vx", "vy")
LOST = {"source": "cam1.mp4", "place": "frame 7", "what": "cannot be decoded", "count": 1}


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """A simulated recording of two targets, its tracks, and the recorded bearings as a table."""
    folder = tmp_path_factory.mktemp("map")
    room = str(folder / "room.mcap")
    assert (
        run(["simulate", str(EXAMPLE), "-o", room, "--steps", str(STEPS), "--targets", "2", "--seed", "7", "-q"]) == 0
    )
    rows = open_recording(folder / "room.mcap").read(Bearings)
    write_table(folder / "bearings.parquet", rows, Provenance("detect"), length_unit="unit")
    assert track(folder, "--diagnostics", str(folder / "diagnostics.parquet"), output="tracks.parquet") == ExitCode.DONE
    return folder


def track(folder: Path, *args: str, source: str = "room.mcap", output: str = "new.parquet") -> int:
    known = [str(folder / a) if a.endswith((".parquet", ".mcap", ".yaml", ".json")) else a for a in args]
    method = [] if "--method" in args else ["--method", "map"]
    return run(["track", str(folder / source), "-o", str(folder / output), "-q", "--overwrite", *method, *known])


def tracks_of(folder: Path, name: str = "new.parquet") -> Tracks:
    return read_table(folder / name, Tracks)


def same(a: Tracks, b: Tracks) -> bool:
    assert np.isfinite(a.cov_x_vx).all()
    assert np.isnan(a.z).all()  # a method on the ground
    return all(np.array_equal(getattr(a, c.name), getattr(b, c.name), equal_nan=True) for c in Tracks.columns())


def covariances(tracks: Tracks):
    """(N, 4, 4), with what is stored once on both sides."""
    C = np.empty((len(tracks), 4, 4))
    for i, a in enumerate(NAMES):
        for j, b in enumerate(NAMES[i:], i):
            name = f"cov_{a}{b}" if j < 2 else f"cov_{a}_{b}"
            C[:, i, j] = C[:, j, i] = getattr(tracks, name)
    return C


def test_tracks_of_a_simulation_are_as_good_as_they_say(made: Path, capsys) -> None:
    """RMSE below 1 of 100 (it is 0.7); squared errors in units of the covariance are about 2 and mostly below 6."""
    capsys.readouterr()
    args = ["evaluate", str(made / "tracks.parquet"), "--truth", str(made / "room.mcap"), "--json"]
    assert run(args) == ExitCode.DONE
    found = json.loads(capsys.readouterr().out)
    assert found["estimates"] == 2 * STEPS
    assert found["rmse_unit"] < 1.0
    assert 1.0 < found["nees_mean"] < 3.5
    assert found["nees_share_95"] > 0.85
    assert found["time_coverage"] == 1.0
    assert run([*args, "--fail-if", "rmse>0.1"]) == ExitCode.THRESHOLD


def test_rows_and_figures_of_a_run(made: Path, capsys) -> None:
    capsys.readouterr()
    assert track(made, "--json", "--seed", "3") == ExitCode.DONE
    summary = json.loads(capsys.readouterr().out)
    assert (summary["targets"], summary["rows"], summary["method"]) == (2, 2 * STEPS, "map")
    assert (summary["searches"], summary["not_converged"], summary["fallbacks"]) == (2, 0, {})
    assert set(summary["iterations"]) == {"0", "1"}
    assert "mean_effective_sample_size" not in summary
    tracks, how = tracks_of(made), read_table(made / "diagnostics.parquet", Diagnostics)
    assert same(tracks, tracks_of(made, "tracks.parquet"))  # whatever the seed: nothing is drawn
    assert np.array_equal(tracks.t_ns, how.t_ns)
    assert np.isnan(how.ess).all()
    assert np.array_equal(np.isfinite(how.log_likelihood), how.n_detected > 0)
    provenance = read_provenance(made / "new.parquet")
    assert provenance.parameters["method"] == "map"
    assert provenance.parameters["loss"] == "mixture"
    assert describe(made / "new.parquet")["length_unit"] == "unit"


def test_a_table_says_of_each_bearing_whether_it_is_believed(made: Path, capsys) -> None:
    capsys.readouterr()
    for lag in ((), ("--lag", "10")):
        out = made / "residuals.parquet"
        assert track(made, "--json", "--residuals", str(out), *lag) == ExitCode.DONE
        summary = json.loads(capsys.readouterr().out)
        found, how = read_table(out, Residuals), read_table(made / "diagnostics.parquet", Diagnostics)
        assert len(found) == summary["bearings"] == int(how.n_detected.sum())
        assert int((found.inlier_probability < 0.5).sum()) == summary["rejected_bearings"] < 0.02 * len(found)
        assert found.inlier_probability @ found.residual**2 / (
            found.inlier_probability @ found.expected_variance
        ) == pytest.approx(summary["nis"])
        assert 0.8 < summary["nis"] < 1.2
        assert set(found.sensor.tolist()) <= {f"cam{k}" for k in range(1, 9)}
        out.unlink()


def test_priors_of_moving_occluders_are_taken_and_their_settings_recorded(made: Path, capsys) -> None:
    """Somebody stands far away: the tracks are nearly the same; no one is known at all: exactly the same."""
    t_ns = np.unique(read_table(made / "bearings.parquet", Bearings).t_ns)
    zero = np.zeros(len(t_ns))
    far = Occluders(
        t_ns=t_ns,
        occluder_id=zero.astype(np.int32),
        x=zero + 900.0,
        y=zero + 900.0,
        cov_xx=zero + 1.0,
        cov_xy=zero,
        cov_yy=zero + 1.0,
    )
    write_table(made / "occluders.parquet", far, Provenance("priors"), length_unit="unit")
    assert track(made, "--occluders", "occluders.parquet", "--set", "occlusion_tempering=0.5") == ExitCode.DONE
    alone, among = tracks_of(made, "tracks.parquet"), tracks_of(made)
    assert len(among) == len(alone)
    assert np.median(np.hypot(among.x - alone.x, among.y - alone.y)) < 0.5
    provenance = read_provenance(made / "new.parquet")
    assert provenance is not None
    assert provenance.parameters["occlusion_tempering"] == 0.5
    old = replace(far, t_ns=t_ns - 3600 * 10**9)
    write_table(made / "occluders.parquet", old, Provenance("priors"), length_unit="unit", overwrite=True)
    assert track(made, "--occluders", "occluders.parquet") == ExitCode.DONE
    assert same(tracks_of(made), alone)


def test_the_covariance_is_whole_and_positive(made: Path) -> None:
    C = covariances(tracks_of(made, "tracks.parquet"))
    assert np.isfinite(C).all()
    assert (np.linalg.eigvalsh(C) > 0.0).all()
    speed = np.sqrt(C[:, 2, 2])
    assert (np.abs(C[:, 0, 2]) < np.sqrt(C[:, 0, 0]) * speed).all()
    assert (np.abs(C[:, 0, 2]) > 0.0).any()


def test_the_same_input_gives_the_same_bytes(made: Path) -> None:
    assert track(made, output="again.parquet") == ExitCode.DONE
    assert (made / "again.parquet").read_bytes() == (made / "tracks.parquet").read_bytes()


def test_each_target_has_the_track_it_has_alone(made: Path) -> None:
    both = tracks_of(made, "tracks.parquet")
    for k in (0, 1):
        assert track(made, "--target", str(k)) == ExitCode.DONE
        assert same(tracks_of(made), both.take(both.target_id == k))


def test_a_lag_gives_the_same_rows_and_nearly_the_same_tracks(made: Path) -> None:
    """With 15 s of eight cameras after each state: 0.05 of 100 in position; with 3 s the RMSE is below 1.2 still."""
    whole = tracks_of(made, "tracks.parquet")
    assert track(made, "--lag", "15") == ExitCode.DONE
    lagged = tracks_of(made)
    assert np.array_equal(lagged.t_ns, whole.t_ns)
    assert np.array_equal(lagged.target_id, whole.target_id)
    assert np.hypot(lagged.x - whole.x, lagged.y - whole.y).max() < 0.05
    assert read_provenance(made / "new.parquet").parameters["lag_s"] == 15.0
    assert track(made, "--lag", "3") == ExitCode.DONE
    short = tracks_of(made)
    assert len(short) == len(whole)
    truth = open_recording(made / "room.mcap").read(Truth)
    error = []
    for t, k, x, y in zip(short.t_ns, short.target_id, short.x, short.y, strict=True):
        row = (truth.t_ns == t) & (truth.target_id == k)
        error.append(np.hypot(truth.x[row][0] - x, truth.y[row][0] - y))
    assert np.sqrt(np.mean(np.square(error))) < 1.2


def test_settings_change_what_they_say(made: Path) -> None:
    assert (
        track(made, "--set", "loss=huber", "--set", "loss_threshold=1.2", "--set", "detection_probability=0.9")
        == ExitCode.DONE
    )
    parameters = read_provenance(made / "new.parquet").parameters
    assert (parameters["loss"], parameters["loss_threshold"], parameters["detection_probability"]) == (
        "huber",
        1.2,
        0.9,
    )
    assert not same(tracks_of(made), tracks_of(made, "tracks.parquet"))
    assert track(made, "--set", "solver=clarabel") == ExitCode.DONE
    by_programs, newton = tracks_of(made), tracks_of(made, "tracks.parquet")
    assert np.hypot(by_programs.x - newton.x, by_programs.y - newton.y).max() < 1e-3


def test_the_tracks_of_inputs_of_both_kinds_are_the_same(made: Path) -> None:
    (made / "scene.yaml").write_text(EXAMPLE.read_text())
    assert track(made, "--scene", "scene.yaml", source="bearings.parquet") == ExitCode.DONE
    assert same(tracks_of(made), tracks_of(made, "tracks.parquet"))


@pytest.mark.parametrize("made_of", [{"losses": [LOST]}, {"by": "hand"}])
def test_what_was_lost_of_the_tracks_of_a_motion_is_lost_for_tracks_too(made: Path, made_of: dict[str, object]) -> None:
    values = {"occlog_motion": 1, "length_unit": "unit", "step_s": 1.0, "sigma": np.eye(4).tolist()}
    values |= {"A": np.kron(np.eye(2), [[1.0, 1.0], [0.0, 1.0]]).tolist()}
    values["_provenance"] = {"command": "fit-motion", "parameters": {}, **made_of}
    (made / "lossy.json").write_text(json.dumps(values))
    assert track(made, "--motion", "lossy.json") == ExitCode.DONE
    assert [loss.as_dict() for loss in read_provenance(made / "new.parquet").losses] == made_of.get("losses", [])


def test_a_fitted_motion_is_used(made: Path, capsys) -> None:
    motion = made / "motion.json"
    args = ["fit-motion", str(made / "tracks.parquet"), "-o", str(motion), "-q", "--overwrite"]
    assert run(args) == ExitCode.DONE
    assert track(made, "--motion", "motion.json") == ExitCode.DONE
    provenance, model = read_provenance(made / "new.parquet"), read_motion(motion)
    assert provenance.parameters["A"] == model.A.ravel().tolist()
    assert provenance.parameters["model_step_s"] == model.step_s
    assert "motion.json" in dict(provenance.inputs)
    tracks, truth = tracks_of(made), tracks_of(made, "tracks.parquet")
    assert 0.0 < np.hypot(tracks.x - truth.x, tracks.y - truth.y).max() < 3.0
    values = json.loads(motion.read_text())
    (made / "metres.json").write_text(json.dumps(values | {"length_unit": "m"}))
    (made / "broken.json").write_text("{")
    capsys.readouterr()
    for options, code, message in [
        (["--motion", "metres.json"], ExitCode.USAGE, "lengths are in m, but the scene's in unit"),
        (["--motion", "motion.json", "--set", "process_noise_velocity=1"], ExitCode.USAGE, "give one of them"),
        (["--motion", "motion.json", "--set", f"Sigma={','.join('1' * 16)}"], ExitCode.USAGE, "give one of them"),
        (["--motion", "broken.json"], ExitCode.BAD_INPUT, "broken.json"),
        (["--motion", "missing.json"], ExitCode.BAD_INPUT, "missing.json"),
    ]:
        assert track(made, *options, output="none.parquet") == code
        error = capsys.readouterr().err
        assert message in error
        assert error.count("\n") == 1
        assert not (made / "none.parquet").exists()


@pytest.mark.parametrize(
    ("args", "code", "message"),
    [
        (
            ["--select", "greedy"],
            ExitCode.USAGE,
            "--select is an option of --method apf, direct3d, pps, not of --method map",
        ),
        (["--calibration", "calibration.parquet"], ExitCode.USAGE, "--calibration"),
        (["--particles", "100"], ExitCode.USAGE, "particles"),
        (["--start", "50,50"], ExitCode.USAGE, "choose one target, e.g."),
        (["--lag", "0"], ExitCode.USAGE, "--lag"),
        (["--lag", "nan"], ExitCode.USAGE, "'--lag': nan is not a finite number"),
        (["--lag", "5", "--method", "fix"], ExitCode.USAGE, "lag"),
        (["--set", "process_noise_velocity=-1"], ExitCode.USAGE, "--set process_noise_velocity=-1: must be "),
        (["--set", "process_noise_velocity=fast"], ExitCode.USAGE, "process_noise_velocity"),
        (["--set", "process_noise_velocity=nan"], ExitCode.USAGE, "process_noise_velocity=nan: must be finite"),
        (["--set", "loss=tukey"], ExitCode.USAGE, "loss=tukey: must be one of mixture, square, huber, cauchy"),
        (["--set", "solver=gurobi"], ExitCode.USAGE, "solver=gurobi: must be one of"),
        (
            ["--set", "detection_probability=1.5"],
            ExitCode.USAGE,
            "detection_probability=1.5: must be above 0 and at most 1",
        ),
        (["--set", "A=1,2,3"], ExitCode.USAGE, "16 numbers"),
        (["--set", "A=" + ",".join(["1"] * 16)], ExitCode.USAGE, "given along with A"),
        (
            ["--set", "estimate=invariant", "--set", "in_front_constraint=false"],
            ExitCode.USAGE,
            "mode where front is false",
        ),
        (["--set", "particels=3"], ExitCode.USAGE, "no setting 'particels'"),
        (["--set", "los=huber"], ExitCode.USAGE, "no setting 'los'; did you mean 'loss'?"),
        (["--target", "9"], ExitCode.BAD_INPUT, "no row is of the chosen targets"),
    ],
)
def test_what_cannot_be_done_is_one_line_and_leaves_no_output(made: Path, capsys, args, code, message) -> None:
    capsys.readouterr()
    assert track(made, *args, output="none.parquet") == code
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (made / "none.parquet").exists()
    assert not (made / "calibration.parquet").exists()


def test_bearings_without_labels_are_refused_and_can_be_labelled(made: Path, capsys) -> None:
    rows = read_table(made / "bearings.parquet", Bearings)
    boxes = replace(rows, target_id=np.full(len(rows), UNLABELLED, dtype=np.int32))
    boxes = boxes.take(boxes.seen)
    write_table(made / "boxes.parquet", boxes, Provenance("detect"), length_unit="unit", overwrite=True)
    capsys.readouterr()
    assert track(made, "--scene", "room.mcap", source="boxes.parquet", output="none.parquet") == ExitCode.BAD_INPUT
    error = capsys.readouterr().err
    assert "`occlog label`" in error
    assert error.count("\n") == 1
    label = ["label", str(made / "boxes.parquet"), "--scene", str(made / "room.mcap"), "-q", "--overwrite"]
    assert (
        run([*label, "--tracks", str(made / "tracks.parquet"), "-o", str(made / "labelled.parquet")]) == ExitCode.DONE
    )
    assert track(made, "--scene", "room.mcap", source="labelled.parquet") == ExitCode.DONE
    again, first = tracks_of(made), tracks_of(made, "tracks.parquet")
    assert len(again) == len(first)
    assert np.median(np.hypot(again.x - first.x, again.y - first.y)) < 0.3


def test_one_start_for_one_target(made: Path) -> None:
    first = tracks_of(made, "tracks.parquet")
    x, y = first.x[first.target_id == 1][0], first.y[first.target_id == 1][0]
    assert track(made, "--start", f"{x},{y},0.1", "--target", "1") == ExitCode.DONE
    tracks = tracks_of(made)
    assert np.hypot(tracks.x[0] - x, tracks.y[0] - y) < 0.1
    assert tracks.cov_xx[0] < 0.011


def test_reports_differences_and_descriptions_take_the_tracks(made: Path, capsys) -> None:
    tracks, how = str(made / "tracks.parquet"), str(made / "diagnostics.parquet")
    page = ["report", tracks, "--scene", str(made / "room.mcap"), "--truth", str(made / "room.mcap"), "-q"]
    assert run([*page, "--diagnostics", how, "-o", str(made / "report.html")]) == ExitCode.DONE
    assert (made / "report.html").stat().st_size > 20_000
    assert run(["diff", tracks, tracks]) == ExitCode.DONE
    assert track(made, "--lag", "3", output="lagged.parquet") == ExitCode.DONE
    lagged = str(made / "lagged.parquet")
    assert run(["diff", tracks, lagged]) == ExitCode.DIFFERENT
    assert run(["diff", tracks, lagged, "--atol", "20"]) == ExitCode.DONE
    capsys.readouterr()
    assert run(["info", tracks]) == ExitCode.DONE
    text = capsys.readouterr().out
    assert "cov_x_vy [unit^2/s]" in text
    assert f"{2 * STEPS} rows" in text


def test_sensors_in_turn_make_a_network_without_overlap(made: Path, capsys) -> None:
    """The particle filter and this method from the same rows; no one ever sees the target along with another."""
    capsys.readouterr()
    args = ("--round-robin", "2", "--diagnostics", "turns.parquet", "--target", "0")
    assert track(made, *args) == ExitCode.DONE
    how, tracks = read_table(made / "turns.parquet", Diagnostics), tracks_of(made)
    assert set(how.n_observing.tolist()) == {1}
    assert how.cameras.tolist()[:4] == ["cam1", "cam1", "cam2", "cam2"]
    assert np.isfinite(tracks.x).all()
    assert (np.linalg.eigvalsh(covariances(tracks)) > 0.0).all()
    whole = tracks_of(made, "tracks.parquet")
    whole = whole.take(whole.target_id == 0)
    assert np.median(np.hypot(tracks.x - whole.x, tracks.y - whole.y)) < 6.0
    assert np.median(tracks.cov_xx) > 3.0 * np.median(whole.cov_xx)


def test_the_track_stays_out_of_the_pillar(tmp_path: Path) -> None:
    """A straight walk along the pillar of [Ercan]'s room, by bearings that point half a unit into it."""
    scene = room100(sigma_read_px=12.0)
    rng = np.random.default_rng(4)
    path = np.column_stack([np.linspace(20.0, 80.0, 40), np.full(40, 59.5)])
    (tmp_path / "scene.yaml").write_text(scene_to_yaml(scene))
    write_table(tmp_path / "b.parquet", observe(scene, path, rng), Provenance("detect"), length_unit="unit")
    for walls in ("true", "false"):
        args = ("--scene", "scene.yaml", "--set", f"wall_constraints={walls}")
        assert track(tmp_path, *args, source="b.parquet") == ExitCode.DONE
        found = tracks_of(tmp_path)
        inside = (np.abs(found.x - 50) < 10 - 1e-6) & (np.abs(found.y - 50) < 10 - 1e-6)
        assert inside.any() == (walls == "false")
