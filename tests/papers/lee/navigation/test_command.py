"""`occlog navigate` on files: the printed example, people of tracks and recordings, one line on bad input."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from places import EXAMPLES

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import describe, read_provenance, read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.records.losses import Loss
from occlog.records.tables import RobotPath, Tracks, Truth

PLANE, ROOM = EXAMPLES / "navigation.yaml", EXAMPLES / "room.yaml"
PRINTED = [str(PLANE), "--from", "12,12", "--to", "6,6", "--obstacle", "8,8", "--no-walls"]
IN_ROOM = [str(ROOM), "--from", "1,2.6", "--to", "7,2.6"]
PNG = b"\x89PNG"


def navigate(tmp_path: Path, *args: str) -> tuple[int, Path]:
    path = tmp_path / "path.parquet"
    return run(["navigate", *args, "-o", str(path), "--json"]), path


def people(tmp_path: Path, unit: str = "m", inputs: tuple[tuple[str, str], ...] = (), x: float = 4.0) -> Path:
    """Tracks of a person who goes down the room."""
    t = np.arange(60)
    flat = np.zeros(60)
    rows = Tracks.of(
        t_ns=t * 100_000_000,
        target_id=np.full(60, 7),
        x=flat + x,
        y=5.5 - 0.08 * t,
        vx=flat,
        vy=flat,
        cov_xx=flat,
        cov_xy=flat,
        cov_yy=flat,
    )
    path = tmp_path / "people.parquet"
    made = Provenance("track", {}, None, inputs, (Loss("cam1", "frame 7", "cut", 1),))
    write_table(path, rows, made, length_unit=unit)
    return path


def test_the_printed_robot_reaches_its_goal_in_8_steps(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    code, path = navigate(tmp_path, *PRINTED)
    result = json.loads(capsys.readouterr().out)
    assert code == ExitCode.DONE
    assert (result["reached"], result["end"], result["steps"]) == (True, "goal reached", 8)
    assert (result["oscillation"], result["collision"], result["trap"]) == (True, False, False)
    rows = read_table(path, RobotPath)
    assert len(rows) == 9
    np.testing.assert_allclose(rows.x[:4], [12.0, 11.0, 10.0, 9.0])
    assert rows.state.tolist() == [*["free"] * 3, "escaping", *["free"] * 4, "end"]
    assert np.isnan(rows.total_x).tolist() == [*[False] * 8, True]
    np.testing.assert_allclose((rows.attractive_x + rows.repulsive_x)[:3], rows.total_x[:3])
    assert rows.recognised.tolist() == [k == 3 for k in range(9)]
    assert (np.diff(rows.t_ns) == 1_000_000_000).all()
    assert rows.clearance.min() == result["least_clearance"]


def test_a_collision_is_reported_in_words_and_is_exit_code_6_with_strict(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    code, path = navigate(tmp_path, *PRINTED, "--force", "original", "--strict")
    out, err = capsys.readouterr()
    assert code == ExitCode.THRESHOLD
    assert "did not reach its goal: collided with obstacle 1 in step 4" in err
    assert json.loads(out)["collision"]
    assert len(read_table(path, RobotPath)) == 5
    path.unlink()
    assert navigate(tmp_path, *PRINTED, "--force", "original")[0] == ExitCode.DONE


def test_the_path_tells_how_it_was_made(tmp_path: Path):
    _, path = navigate(tmp_path, *PRINTED, "--radius", "0.2", "--set", "repulsion=4")
    made = read_provenance(path)
    assert made.command == "navigate"
    assert (made.parameters["radius"], made.parameters["repulsion"]) == (0.2, 4.0)
    assert (made.parameters["start"], made.parameters["disc_obstacles"]) == ([12.0, 12.0], [[8.0, 8.0, 0.0]])
    assert describe(path)["schema"] == "robot_path"


@pytest.mark.drawn
def test_a_picture_comes_with_the_path(tmp_path: Path):
    picture = tmp_path / "path.png"
    tracks = people(tmp_path)
    code, _ = navigate(tmp_path, *IN_ROOM, "--obstacles", str(tracks), "--picture", str(picture), "-q")
    assert code == ExitCode.DONE  # the tracks say that a frame was lost
    assert picture.read_bytes().startswith(PNG)


def test_people_of_tracks_are_avoided_and_what_was_lost_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    code, _ = navigate(tmp_path, *IN_ROOM, "--obstacles", str(people(tmp_path)))
    out, err = capsys.readouterr()
    result = json.loads(out)
    assert code == ExitCode.DONE
    assert "frame 7" in err
    assert result["reached"]
    assert result["least_clearance"] > 0.0


def test_people_of_a_recording_are_avoided_from_a_later_time_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    recording = tmp_path / "sim.parquet"
    t = np.arange(100)
    truth = Truth.of(
        t_ns=t * 100_000_000,
        target_id=np.zeros(100, np.int32),
        role=np.full(100, "target"),
        x=0.5 + 0.05 * t,
        y=np.full(100, 4.6),
        z=np.full(100, 0.9),
    )
    write_table(recording, truth, Provenance("simulate"))
    code, path = navigate(tmp_path, *IN_ROOM, "--obstacles", str(recording), "--start-delay", "2")
    assert code == ExitCode.DONE
    assert read_table(path, RobotPath).t_ns[0] == 2_000_000_000
    capsys.readouterr()


@pytest.mark.parametrize(
    ("args", "code", "words"),
    [
        (["--from", "3.9,2.8", "--to", "7,3"], 4, 'is inside static occluder pillar", "file": '),
        (["--from", "1,1", "--to", "8.5,3"], 4, "the goal (8.5, 3) is outside the room"),
        (["--from", "1,1", "--to", "3.9,2.8"], 4, "the goal (3.9, 2.8) is inside static occluder pillar"),
        (["--from", "1,1", "--to", "7,3", "--speed", "0"], 2, "--speed"),
        (["--from", "1,1", "--to", "7,3", "--step", "0"], 2, "--step"),
        (["--from", "1,1", "--to", "7,3", "--set", "repulsion=-1"], 2, "--set repulsion=-1: must be at least 0"),
        (["--from", "1,1", "--to", "7,3", "--set", "nothing=1"], 2, "no setting 'nothing'"),
        (["--from", "1", "--to", "7,3"], 2, "--from 1: must be 2 numbers"),
        (["--from", "1,nan", "--to", "7,3"], 2, "finite"),
        (["--from", "1,1", "--to", "7,3", "--obstacle", "2,2,-1"], 2, "the radius must be at least 0"),
        (
            ["--from", "1,1", "--to", "7,3", "--start-delay", "3"],
            2,
            "--start-delay counts from the first row of --obstacles",
        ),
        (["--from", "1,1", "--to", "7,3", "--obstacles", str(PLANE)], 4, "navigation.yaml"),
    ],
)
def test_bad_input_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], args: list[str], code: int, words: str
):
    assert navigate(tmp_path, str(ROOM), *args)[0] == code
    err = capsys.readouterr().err
    assert words in err
    assert err.count("\n") == 1
    assert not (tmp_path / "path.parquet").exists()


def test_tracks_in_another_unit_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    tracks = people(tmp_path, unit="ft", inputs=(("a.mcap", "0" * 64),))
    assert navigate(tmp_path, *IN_ROOM, "--obstacles", str(tracks))[0] == ExitCode.BAD_INPUT
    assert "lengths are in ft, but in m in the scene" in capsys.readouterr().err


def test_tracks_that_have_ended_before_the_start_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    tracks = people(tmp_path)
    assert navigate(tmp_path, *IN_ROOM, "--obstacles", str(tracks), "--start-delay", "60")[0] == ExitCode.BAD_INPUT
    assert "has no rows from 60 s after its first one on" in capsys.readouterr().err


def test_a_start_inside_a_person_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    tracks = people(tmp_path, x=1.0)
    args = [str(ROOM), "--from", "1,5.4", "--to", "7,2.6"]
    assert navigate(tmp_path, *args, "--obstacles", str(tracks))[0] == ExitCode.BAD_INPUT
    assert "inside person 7" in capsys.readouterr().err


def test_outputs_are_not_replaced_unless_asked(tmp_path: Path):
    assert navigate(tmp_path, *PRINTED)[0] == ExitCode.DONE
    assert navigate(tmp_path, *PRINTED)[0] == ExitCode.EXISTS
    assert navigate(tmp_path, *PRINTED, "--overwrite")[0] == ExitCode.DONE
