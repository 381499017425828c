"""`occlog evaluate` on files: outputs, exit codes, one-line errors."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.evaluate.results import LABEL, number, summary_lines
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import read_provenance, read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.scenes.scene import scene_from_yaml, scene_to_yaml
from occlog.io.recording.writer import RecordingWriter
from occlog.records.losses import Loss
from occlog.records.tables import Bearings, Bound, Errors, Tracks, Truth, TruthBoxes

SCENE = scene_from_yaml(
    """
occlog_scene: 1
room: [[0, 0], [20, 0], [20, 20], [0, 20]]
cameras:
  - {name: east, position: [0, 10], yaw_deg: 0, focal_px: 100, fov_deg: 90, noise: {measurement_noise_px: 1}}
  - {name: north, position: [10, 0], yaw_deg: 90, focal_px: 100, fov_deg: 90, noise: {measurement_noise_px: 1}}
""",
    "scene",
)
T = 1_700_000_000_000_000_000 + np.arange(5) * 1_000_000_000
LOSS = Loss("cam", "frame 7", "cut", 1)
MADE = Provenance("test", losses=(LOSS,))


def truth_table() -> Truth:
    five = np.full(5, 10.0)
    return Truth.of(t_ns=T, target_id=np.zeros(5, np.int32), role=["target"] * 5, x=five, y=five, z=five * np.nan)


def tracks_table(error: float = 0.6, target: int = 0) -> Tracks:
    five, nan = np.full(5, 10.0), np.full(5, np.nan)
    return Tracks.of(
        t_ns=T,
        target_id=np.full(5, target, np.int32),
        x=five + error,
        y=five,
        vx=nan,
        vy=nan,
        cov_xx=five,
        cov_xy=0 * five,
        cov_yy=five,
    )


def bearings_table() -> Bearings:
    n = 10
    sensor = np.tile(["east", "north"], 5)
    return Bearings.of(
        t_ns=np.repeat(T, 2),
        sensor=sensor,
        target_id=np.zeros(n, np.int32),
        seen=np.ones(n, bool),
        bearing=np.where(sensor == "east", 0.0, math.pi / 2),
        sigma=np.full(n, 0.01),
        u_px=np.zeros(n),
        sigma_px=np.ones(n),
        score=np.full(n, np.nan),
    )


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder with tracks, truth, bearings, a scene, and a recording that has the truth and the scene."""
    write_table(tmp_path / "tracks.parquet", tracks_table(), MADE)
    write_table(tmp_path / "truth.parquet", truth_table(), MADE)
    write_table(tmp_path / "bearings.parquet", bearings_table(), MADE)
    (tmp_path / "scene.yaml").write_text(scene_to_yaml(SCENE))
    with RecordingWriter(tmp_path / "recording.mcap", SCENE, MADE) as writer:
        writer.table(truth_table())
    monkeypatch.chdir(tmp_path)
    return tmp_path


FULL = ["evaluate", "tracks.parquet", "--truth", "recording.mcap", "--bearings", "bearings.parquet"]


def test_all_outputs(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = run([*FULL, "-o", "metrics.json", "--errors", "errors.parquet", "--bound", "bound.parquet"])
    assert code == ExitCode.DONE
    captured = capsys.readouterr()
    assert f"occlog: lost earlier: {LOSS}\n" in captured.err
    values = json.loads((folder / "metrics.json").read_text())
    assert values["rmse_m"] == pytest.approx(0.6)
    assert values["detection_rate"] == 1.0
    assert values["bound_ratio"] == pytest.approx(0.6 / values["bound_rmse_m"])
    assert values["triangulation_distance_max_m"] == pytest.approx(0.6)
    assert list(values) == sorted(values)
    assert all(
        v is None or isinstance(v, int | float) for k, v in values.items() if k not in ("_provenance", "warnings")
    )
    made = values["_provenance"]
    assert made["command"] == "evaluate"
    assert made["parameters"]["match"] == "id"
    assert [i["name"] for i in made["inputs"]] == ["tracks.parquet", "recording.mcap", "bearings.parquet"]
    assert made["losses"] == [LOSS.as_dict()]
    assert len(read_table(folder / "errors.parquet", Errors)) == 5
    assert len(read_table(folder / "bound.parquet", Bound)) == 5
    assert read_provenance(folder / "bound.parquet").command == "evaluate"
    assert "RMSE" in captured.out
    assert "RMSE / bound" in captured.out
    assert "wrote metrics.json" in captured.err


def test_same_input_gives_the_same_bytes(folder: Path) -> None:
    for name in ("a", "b"):
        assert run([*FULL, "-o", f"{name}.json", "--errors", f"{name}.parquet", "-q"]) == 0
    assert (folder / "a.json").read_bytes() == (folder / "b.json").read_bytes()
    assert (folder / "a.parquet").read_bytes() == (folder / "b.parquet").read_bytes()


def test_json_on_standard_output_is_one_flat_object(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run([*FULL, "--json"]) == ExitCode.DONE
    out, err = capsys.readouterr()
    values = json.loads(out)
    assert values["rmse_m"] == pytest.approx(0.6)
    assert values["bearing_nis"] == pytest.approx(0.0, abs=1e-20)
    assert err == f"occlog: lost earlier: {LOSS}\n"


def test_tracks_and_a_truth_need_no_scene_but_bearings_do(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    args = ["evaluate", "tracks.parquet", "--truth", "truth.parquet"]
    assert run(args) == ExitCode.DONE
    alone = capsys.readouterr().out
    assert run([*args, "--bearings", "bearings.parquet"]) == ExitCode.USAGE
    assert "--scene" in capsys.readouterr().err
    assert run([*args, "--scene", "scene.yaml"]) == ExitCode.DONE
    assert capsys.readouterr().out == alone
    assert run([*args, "--scene", "recording.mcap"]) == ExitCode.DONE


def test_exit_code_6_when_a_threshold_is_broken_and_outputs_are_there(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = run([*FULL, "-o", "m.json", "--errors", "e.parquet", "--fail-if", "rmse>0.5", "--fail-if", "rmse_x<0.1"])
    assert code == ExitCode.THRESHOLD == 6
    assert (folder / "m.json").is_file()
    assert (folder / "e.parquet").is_file()
    err = capsys.readouterr().err
    assert "--fail-if rmse>0.5: rmse_m is 0.6" in err
    assert "rmse_x" not in err


def test_exit_code_6_when_a_metric_is_missing_or_not_a_number(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_table(folder / "none.parquet", Tracks.empty(), MADE)
    args = ["evaluate", "none.parquet", "--truth", "recording.mcap", "-o", "m.json"]
    assert run([*args, "--fail-if", "rmse>0.5", "--fail-if", "bound_ratio>2"]) == ExitCode.THRESHOLD
    err = capsys.readouterr().err
    assert "rmse_m is not a number" in err
    assert "no metric 'bound_ratio'" in err
    assert json.loads((folder / "m.json").read_text())["rmse_m"] is None


def test_thresholds_that_hold(folder: Path) -> None:
    assert run([*FULL, "--fail-if", "rmse>0.7", "--fail-if", "detection_rate<1"]) == ExitCode.DONE


def test_exit_code_2_for_a_condition_that_is_none_before_any_work(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run([*FULL, "-o", "m.json", "--fail-if", "rmse=0.5"]) == ExitCode.USAGE
    assert not (folder / "m.json").exists()
    err = capsys.readouterr().err
    assert err.startswith("occlog: error: --fail-if 'rmse=0.5'")
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    "args",
    [
        [],
        ["tracks.parquet"],
        ["--bearings", "bearings.parquet"],
        ["--views", "views.parquet"],
        ["tracks.parquet", "--truth", "recording.mcap", "--held-out", "east"],
    ],
)
def test_exit_code_2_for_nothing_to_compare(folder: Path, args: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "views.parquet").touch()
    assert run(["evaluate", *args]) == ExitCode.USAGE
    assert capsys.readouterr().err.count("\n") == 1


def test_exit_code_7_when_an_output_exists(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "m.json").write_text("mine")
    assert run([*FULL, "-o", "m.json", "--errors", "e.parquet"]) == ExitCode.EXISTS
    assert (folder / "m.json").read_text() == "mine"
    assert not (folder / "e.parquet").exists()
    assert run([*FULL, "-o", "m.json", "--overwrite"]) == ExitCode.DONE
    assert "rmse_m" in (folder / "m.json").read_text()
    assert run([*FULL, "-o", "tracks.parquet", "--overwrite"]) == ExitCode.USAGE


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["missing.parquet", "--truth", "recording.mcap"], "missing.parquet: no such file"),
        (["bearings.parquet", "--truth", "recording.mcap"], "bearings.parquet: holds bearings; expected tracks"),
        (["tracks.parquet", "--truth", "cut.mcap"], "cut.mcap"),
        (["tracks.parquet", "--truth", "empty.parquet", "--scene", "scene.yaml"], "empty.parquet: is empty"),
        (["other.parquet", "--truth", "recording.mcap"], "no target_id of a track (5)"),
        (["feet.parquet", "--truth", "recording.mcap"], "feet.parquet: lengths are in ft, but in m in the scene"),
        (["tracks.parquet", "--truth", "bare.mcap"], "bare.mcap: holds no truth"),
        (["tracks.parquet", "--truth", "recording.mcap", "--bearings", "recording.mcap"], "holds no bearings"),
        (["--views", "tracks.parquet", "--truth", "recording.mcap"], "holds no true boxes"),
        ([*FULL[1:], "--held-out", "cam9"], "sensor 'cam9' is not in the scene"),
    ],
)
def test_exit_code_4_for_bad_input_is_one_line(
    folder: Path, args: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "cut.mcap").write_bytes((folder / "recording.mcap").read_bytes()[:-40])
    (folder / "empty.parquet").write_bytes(b"")
    write_table(folder / "other.parquet", tracks_table(target=5), MADE)
    write_table(folder / "feet.parquet", tracks_table(), MADE, length_unit="ft")
    with RecordingWriter(folder / "bare.mcap", SCENE, MADE) as writer:
        writer.table(bearings_table())
    assert run(["evaluate", *args, "-o", "m.json"]) == ExitCode.BAD_INPUT
    out, err = capsys.readouterr()
    assert words in err
    assert err.startswith("occlog: error: ")
    assert err.count("\n") == 1
    assert out == ""
    assert not (folder / "m.json").exists()


def test_held_out_without_truth(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    args = ["evaluate", "tracks.parquet", "--bearings", "bearings.parquet", "--scene", "scene.yaml"]
    assert run([*args, "--held-out", "north", "--json"]) == ExitCode.DONE
    values = json.loads(capsys.readouterr().out)
    assert values["held_out_rms_px"] == pytest.approx(6.0)  # 0.6 of 10 at 100 px
    assert "rmse_m" not in values
    assert run([*args, "--held-out", "east,north", "--errors", "e.parquet"]) == ExitCode.DONE
    assert len(read_table(folder / "e.parquet", Errors)) == 0


def test_tracks_made_with_the_held_out_sensor_are_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = Provenance("track", {"sensors": ["east", "north"]})
    write_table(folder / "all.parquet", tracks_table(), made)
    args = ["evaluate", "all.parquet", "--bearings", "bearings.parquet", "--scene", "scene.yaml"]
    assert run([*args, "--held-out", "north"]) == ExitCode.BAD_INPUT
    assert (
        "was made with north, which --held-out predicts; make it again with `occlog track --without north`"
        in capsys.readouterr().err
    )
    write_table(folder / "some.parquet", tracks_table(), Provenance("track", {"sensors": ["east"]}))
    assert run(["evaluate", "some.parquet", *args[2:], "--held-out", "north"]) == ExitCode.DONE


def test_views_against_true_boxes(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    boxes = TruthBoxes.of(
        t_ns=T[:1],
        sensor=["east"],
        frame=[0],
        box=np.zeros(1, np.int32),
        target_id=np.zeros(1, np.int32),
        left_px=[0.0],
        top_px=[0.0],
        width_px=[10.0],
        height_px=[20.0],
        confidence=[np.nan],
    )
    from occlog.records.tables import Views

    write_table(folder / "boxes.parquet", boxes, MADE)
    write_table(folder / "views.parquet", Views.empty(), MADE)
    args = ["evaluate", "--views", "views.parquet", "--truth", "boxes.parquet", "--json"]
    assert run([*args, "--scene", "scene.yaml"]) == ExitCode.DONE
    capsys.readouterr()
    assert run(args) == ExitCode.DONE  # no scene is needed
    values = json.loads(capsys.readouterr().out)
    assert (values["views_recall"], values["views_precision"]) == (0.0, None)


def test_options_are_given_in_degrees_and_milliradians_and_names_with_commas(folder: Path) -> None:
    more = [
        "--held-out",
        "east,north",
        "--held-out-gate-mrad",
        "20",
        "--triangulation-min-angle-deg",
        "3",
        "--prior",
        "4",
        "1",
        "4",
    ]
    assert run([*FULL, *more, "-o", "m.json"]) == ExitCode.DONE
    used = json.loads((folder / "m.json").read_text())["_provenance"]["parameters"]
    assert used["held_out"] == ["east", "north"]
    assert used["held_out_gate"] == pytest.approx(0.02)
    assert used["triangulation_min_angle"] == pytest.approx(math.radians(3))
    assert used["prior_covariance"] == [4.0, 1.0, 4.0]


def test_a_prior_that_is_no_covariance_is_an_error_of_usage(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    assert run([*FULL, "--prior", "1", "2", "1"]) == ExitCode.USAGE
    assert "--prior (1.0, 2.0, 1.0): must be xx, xy, yy of a positive covariance" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("args", "words"),
    [
        ([*FULL, "--distance-gate", "1"], "--distance-gate is for tracks in images"),
        ([*FULL, "--doa-gate", "1"], "--doa-gate is for directions against true ones (--truth-azimuths)"),
        (
            ["evaluate", "--bearings", "bearings.parquet", "--assigned-target", "id"],
            "not for bearings, views, or TRACKS",
        ),
        (["evaluate", "--truth-azimuths", "a.csv", "--motion", "cv"], "--motion is for TRACKS on the ground"),
    ],
)
def test_options_of_another_kind_of_input_are_refused(
    folder: Path, args: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "a.csv").touch()
    assert run(args) == ExitCode.USAGE
    assert words in capsys.readouterr().err


def test_motion_and_diameter_of_a_simulation_are_taken_over(folder: Path) -> None:
    simulated = Provenance("simulate", {"world": {"sigma": 0.2, "diameter": 0.7}, "observe": None})
    with RecordingWriter(folder / "simulated.mcap", SCENE, simulated) as writer:
        writer.table(truth_table())
    args = ["evaluate", "tracks.parquet", "--truth", "simulated.mcap", "--bearings", "bearings.parquet"]
    used = []
    for more in ([], ["--process-noise", "0.9", "--occluder-diameter", "1"]):
        assert run([*args, *more, "-o", "m.json", "--overwrite"]) == ExitCode.DONE
        used.append(json.loads((folder / "m.json").read_text())["_provenance"]["parameters"])
    assert [(p["process_noise_position"], p["occluder_diameter"]) for p in used] == [(0.2, 0.7), (0.9, 1.0)]
    assert run([*FULL, "-o", "m.json", "--overwrite"]) == ExitCode.DONE
    plain = json.loads((folder / "m.json").read_text())["_provenance"]["parameters"]
    assert (plain["process_noise_position"], plain["occluder_diameter"]) == (0.05, None)


def test_scene_of_a_recording_with_the_bearings(folder: Path) -> None:
    with RecordingWriter(folder / "seen.mcap", SCENE, MADE) as writer:
        writer.table(bearings_table())
    assert run(["evaluate", "tracks.parquet", "--bearings", "seen.mcap"]) == ExitCode.DONE


def test_summary_for_a_person() -> None:
    metrics = {
        "rmse_m": 0.123456,
        "rmse_target_0_m": 0.1,
        "rmse_target_12_m": math.nan,
        "estimates": 4000.0,
        "detection_rate": 0.5,
        "detection_rate_sensor_cam a": 0.25,
        "bearing_rms_sensor_cam a_px": 2.0,
    }
    text = "\n".join(summary_lines(metrics, "m"))
    assert f"  {'RMSE':<{LABEL}}      0.1235 m" in text
    longest = {"estimates": 5.0, "estimates_without_truth": 2.0, "estimates_interpolated_truth": 1.0}
    ends = {len(line) for line in summary_lines(longest, "m") if line.startswith("  ")}
    assert len(ends) == 1  # numbers stand below one another
    assert "4000" in text
    lines = text.splitlines()
    assert [line.split() for line in lines if line.startswith(("0 ", "12 ", "cam a"))] == [
        ["0", "0.1"],
        ["12", "-"],
        ["cam", "a", "0.25", "2"],
    ]
    assert "bound" not in text
    assert number(math.nan) == "-"


def test_positions_of_another_program_are_paired_by_distance_and_need_no_covariance(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Identities are that program's own; nothing is stated of covariances that are not there."""
    (folder / "truth.csv").write_text(
        "t,id,x,y\n" + "".join(f"{n},{k},{n},{10 * k}\n" for n in range(40) for k in (1, 2))
    )
    (folder / "mine.csv").write_text(
        "t,track_id,x_cm,y_cm\n"
        + "".join(f"{n},{3 - k},{100 * n + 30},{1000 * k}\n" for n in range(40) for k in (1, 2))
    )
    assert (
        run(["evaluate", "mine.csv", "--truth", "truth.csv", "--scene", "scene.yaml", "-o", "own.json"])
        == ExitCode.DONE
    )
    captured = capsys.readouterr()
    assert "matching by distance" in captured.err
    assert "note: estimates have no covariance" in captured.err
    assert "plausible: yes" in captured.out
    figures = json.loads((folder / "own.json").read_text())
    assert figures["rmse_m"] == pytest.approx(0.3)
    assert not [name for name in figures if name.startswith("nees")]


def counted(folder: Path, name: str, header: str = "frame,id,x,y", first: int = 0) -> Path:
    """Positions of one target in 20 frames."""
    rows = [f"{k + first},1,{10 + 0.1 * k},5" for k in range(20)]
    (folder / name).write_text("\n".join([header, *rows]) + "\n")
    return folder / name


def test_a_truth_that_counts_frames_needs_their_rate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth = counted(tmp_path, "truth.csv")
    rows = [f"{0.04 * k:.2f},1,{10.2 + 0.1 * k},5" for k in range(20)]
    (tmp_path / "tracks.csv").write_text("\n".join(["time,id,x,y", *rows]) + "\n")
    command = ["evaluate", str(tmp_path / "tracks.csv"), "--truth", str(truth), "--json"]
    assert run(command) == ExitCode.BAD_INPUT
    result = json.loads(capsys.readouterr().err)
    assert (result["error"], result["hint"]) == ("column frame counts frames, not times", "give the frame rate (--fps)")
    assert run([*command, "--fps", "25"]) == ExitCode.DONE
    assert json.loads(capsys.readouterr().out)["rmse_m"] == pytest.approx(0.2)
    counted(tmp_path, "tracks.csv")
    assert run([*command, "--fps", "29.97"]) == ExitCode.DONE
    assert json.loads(capsys.readouterr().out)["rmse_m"] == pytest.approx(0.0, abs=1e-9)


def test_a_rate_is_refused_where_no_table_counts_frames(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth = counted(tmp_path, "truth.csv", "time_s,id,x,y")
    assert run(["evaluate", str(truth), "--truth", str(truth), "--fps", "25"]) == ExitCode.USAGE
    assert "--fps is for tables that count frames" in capsys.readouterr().err
    negative = counted(tmp_path, "negative.csv", first=-3)
    assert run(["evaluate", str(negative), "--truth", str(truth), "--fps", "25"]) == ExitCode.BAD_INPUT
    assert "line 2: frame is -3; frames are numbered from 0" in capsys.readouterr().err


def test_times_that_have_nothing_in_common_are_stated_in_seconds(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, start in (("tracks", 0), ("truth", 100)):
        rows = [f"{start + 0.25 * k},1,{k},5" for k in range(5)]
        (tmp_path / f"{name}.csv").write_text("\n".join(["time_s,id,x,y", *rows]) + "\n")
    run(["evaluate", str(tmp_path / "tracks.csv"), "--truth", str(tmp_path / "truth.csv")])
    assert "tracks 0 to 1 s, truth 100 to 101 s" in capsys.readouterr().err
