from __future__ import annotations

import json

import numpy as np
import pytest
from heard_scenes import ROOM

from occlog.cli.main import run as occlog
from occlog.errors import ExitCode, UsageError
from occlog.io.files.tables.parquet import read_table
from occlog.records.tables import Cooperation, Tracks
from occlog.track.run import parse_starts

pytestmark = pytest.mark.jit


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A recording of two walkers, heard by two arrays and seen by three cameras."""
    path = tmp_path_factory.mktemp("cooperate")
    (path / "scene.yaml").write_text(ROOM)
    made = ["simulate", str(path / "scene.yaml"), "-o", str(path / "rec.mcap"), "--targets", "2", "--seconds", "12"]
    assert occlog([*made, "--rate", "5", "--speed", "0.5", "--seed", "4", "-q"]) == ExitCode.DONE
    return path


def run(folder, name, *more):
    return occlog(
        [
            "track",
            str(folder / "rec.mcap"),
            "--method",
            "imm",
            "-o",
            str(folder / f"{name}.parquet"),
            "--overwrite",
            "-q",
            "--json",
            "--particles",
            "200",
            *more,
        ]
    )


def test_tracks_and_requests_are_written_and_counted(folder, capsys):
    asked, tracks = folder / "asked.parquet", folder / "t.parquet"
    policy = ["--cooperate", "periodic", "--set", "period_s=3", "--cooperation", str(asked)]
    assert run(folder, "t", *policy) == ExitCode.DONE
    summary = json.loads(capsys.readouterr().out)
    table = read_table(asked, Cooperation)
    own = table.take(table.cause != "shared")
    assert summary["requests"] == len(own) > 0
    assert summary["requests_by_cause"]["periodic"] == len(own)
    assert summary["frames_asked"] == table.frames.sum()
    assert summary["frames_offered"] == 3 * 61
    assert np.isfinite(read_table(tracks, Tracks).x).all()
    code = occlog(
        [
            "evaluate",
            str(tracks),
            "--truth",
            str(folder / "rec.mcap"),
            "--match",
            "optimal",
            "--cooperation",
            str(asked),
            "--json",
            "-q",
        ]
    )
    assert code == ExitCode.DONE
    metrics = json.loads(capsys.readouterr().out)
    assert metrics["cooperation_requests"] == len(own)
    assert metrics["cooperation_frames"] == table.frames.sum()
    assert metrics["cooperation_period_s"] == pytest.approx(12 / 4, rel=0.2)
    assert metrics["rmse_m"] < 2.0


def test_the_same_seed_writes_the_same_file(folder, capsys):
    found = []
    for name in ("a", "b"):
        assert run(folder, name, "--cooperate", "spread,count", "--seed", "3") == ExitCode.DONE
        found.append(read_table(folder / f"{name}.parquet", Tracks))
    np.testing.assert_array_equal(found[0].x, found[1].x)
    capsys.readouterr()


def test_starts_of_several_targets(folder, capsys):
    starts = ["--start", "5,5", "--start", "9,9,1,0.5,0,0.2"]
    assert run(folder, "s", *starts, "--set", "association=any") == ExitCode.DONE
    assert json.loads(capsys.readouterr().out)["targets"] == 2


@pytest.mark.parametrize(
    ("more", "code", "reported"),
    [
        (["--cooperate", "often"], ExitCode.USAGE, "--cooperate often: must be of none, periodic"),
        (["--cameras", "a1,a2,c1", "--cooperate", "spread"], ExitCode.USAGE, "requires two cameras with a pose"),
        (["--cameras", "c1,c2"], ExitCode.BAD_INPUT, "no row is of a microphone array"),
        (["--start", "1"], ExitCode.USAGE, "expected X,Y"),
        (["--start", "1,2,3,4"], ExitCode.USAGE, "expected X,Y, X,Y,SIGMA or X,Y,SIGMA,VX,VY,SIGMA_V"),
        (
            ["--select", "greedy"],
            ExitCode.USAGE,
            "--select is an option of --method apf, direct3d, pps, not of --method imm",
        ),
        (
            ["--set", "detection_probability=2"],
            ExitCode.USAGE,
            "--set detection_probability=2: must be above 0 and at most 1",
        ),
    ],
)
def test_what_cannot_be_is_reported_in_one_line(folder, capsys, more, code, reported):
    assert run(folder, "bad", *more) == code
    error = capsys.readouterr().err
    assert reported in error
    assert error.count("\n") == 1
    assert not (folder / "bad.parquet").exists()


def test_options_of_cooperation_go_with_the_method(folder, capsys):
    code = occlog(["track", str(folder / "rec.mcap"), "-o", str(folder / "x.parquet"), "--cooperate", "spread"])
    assert code == ExitCode.USAGE
    assert "--cooperate is an option of --method imm, not of --method apf" in capsys.readouterr().err


def test_no_one_heard_is_reported(folder, capsys):
    code = occlog(
        [
            "track",
            str(folder / "rec.mcap"),
            "--method",
            "imm",
            "-o",
            str(folder / "n.parquet"),
            "--overwrite",
            "--set",
            "birth_probability=0",
        ]
    )
    assert code == ExitCode.DONE
    assert "no target was found, and the tracks are empty" in capsys.readouterr().err
    assert len(read_table(folder / "n.parquet", Tracks)) == 0


def test_several_starts_are_for_this_method_only():
    assert parse_starts(("1,2,3",), "apf", "m") == "1,2,3"
    with pytest.raises(UsageError, match="give it once"):
        parse_starts(("1,2", "3,4"), "apf", "m")
    assert parse_starts(("1,2", "3,4,1,5,6,7"), "imm", "m") == "1,2,0.5,0,0,1.0,3,4,1,5,6,7"
