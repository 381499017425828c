"""`occlog report A B` on files: page, words and summary, what cannot be laid side by side, the same bytes again."""

from __future__ import annotations

import html
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from two_runs import STEP, exchanged_at, lost, moved, tracks, truth, write_run

from occlog.cli.main import load_command, run
from occlog.cli.setting_options import VariantCommand
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.scenes.scene import scene_from_yaml
from occlog.io.recording.writer import RecordingWriter
from occlog.records.losses import Loss
from occlog.records.tables import Errors, PeopleTracks
from occlog.report.comparison import run as inputs
from occlog.report.comparison.run import names_of

SCENE = """
occlog_scene: 1
room: [[-1, -1], [9, -1], [9, 9], [-1, 9]]
cameras:
  - {name: east, position: [0, 4], yaw_deg: 0, focal_px: 100, fov_deg: 90, noise: {measurement_noise_px: 1}}
"""


def report(*args: object) -> int:
    return run(["report", *(str(a) for a in args)])


def with_recording(folder: Path, frames: int = 60, scene: str = SCENE) -> Path:
    """A run folder that has its recording, too."""
    with RecordingWriter(folder / "recording.mcap", scene_from_yaml(scene, "scene"), Provenance("ingest")) as out:
        out.table(truth(frames))
    return folder


@pytest.fixture
def runs(tmp_path: Path) -> tuple[Path, Path]:
    """Two run folders of one recording; the second one exchanges two people at 2.5 s."""
    a = with_recording(write_run(tmp_path / "old", tracks(), (Loss("east", "frame 7", "cut short", 3),)))
    return a, with_recording(write_run(tmp_path / "new", tracks(60, exchanged_at(25))))


def words(page: Path) -> str:
    """What is to be read in a page, without markup."""
    return " ".join(html.unescape(re.sub(r"<[^>]+>", " ", page.read_text())).split())


def test_page_words_and_summary_of_two_run_folders(runs: tuple[Path, Path], tmp_path: Path, capsys: Any) -> None:
    page, markdown = tmp_path / "beside.html", tmp_path / "beside.md"
    assert report(*runs, "-o", page, "--markdown", markdown, "--json") == ExitCode.DONE
    out, err = capsys.readouterr()
    assert "lost earlier in A: east: frame 7: cut short (3 lost)" in err
    result = json.loads(out)
    assert (result["a"], result["b"], result["same"], result["frames"]) == ("old", "new", False, 60)
    assert result["true_frames"] == 60
    assert result["first_divergence"] == {
        "kind": "another partner", "seconds": 2.5, "t_ns": 25 * STEP, "a": 10, "b": 11, "distance": 0.0,
    }  # fmt: skip
    assert result["changes"] == result["switches"] == {"a": 0, "b": 2}
    assert result["figures"]["mota"]["a"] == 1.0
    assert result["figures"]["mota"]["b"] == pytest.approx(1 - 2 / 180)
    assert result["figures"]["idf1"]["verdict"] == "not decided"
    assert result["figures"]["recall"] == {"a": 1, "b": 1, "difference": 0, "low": 0, "high": 0, "p": 1} | {
        "verdict": "no difference shown"
    }
    text = words(page)
    assert "They first diverge at 2.50 s" in text
    assert "2 of B the other run does not have" in text
    assert "person 0" in text
    assert 'data-time="2.5"' in page.read_text()
    assert (
        "person 0 | 10 \\(0.00 to 5.90 s\\) | 10 \\(0.00 to 2.40 s\\), 11 \\(2.50 to 5.90 s\\)" in markdown.read_text()
    )
    assert str(tmp_path) not in page.read_text()


def test_the_same_command_makes_the_same_bytes(runs: tuple[Path, Path], tmp_path: Path) -> None:
    for name in ("one", "two"):
        assert report(*runs, "-o", tmp_path / f"{name}.html", "--markdown", tmp_path / f"{name}.md", "-q") == 0
    assert (tmp_path / "one.html").read_bytes() == (tmp_path / "two.html").read_bytes()
    assert (tmp_path / "one.md").read_bytes() == (tmp_path / "two.md").read_bytes()
    assert report(*runs, "-o", tmp_path / "one.html", "-q") == ExitCode.EXISTS


def test_a_run_next_to_itself_is_the_same(runs: tuple[Path, Path], tmp_path: Path, capsys: Any) -> None:
    page = tmp_path / "same.html"
    assert report(runs[0], runs[0], "-o", page, "--json", "-q") == ExitCode.DONE
    result = json.loads(capsys.readouterr().out)
    assert result["same"] is True
    assert result["heading"] == "The two runs are the same"
    assert (result["a"], result["b"]) == ("old", "old, again")
    assert "first_divergence" not in result
    assert all(figure["difference"] == 0 for figure in result["figures"].values())
    assert {figure["verdict"] for figure in result["figures"].values()} == {"no difference shown"}
    assert "Every estimate of one is an estimate of the other" in words(page)


def test_a_run_that_is_worse_is_reported_so_with_its_interval(tmp_path: Path, capsys: Any) -> None:
    table = tracks(400)
    table.y[:] += np.random.default_rng(3).normal(0, 0.3, len(table))
    a, b = write_run(tmp_path / "a", tracks(400)), write_run(tmp_path / "b", table)
    write_table(tmp_path / "truth.parquet", truth(400), Provenance("simulate"))
    page = tmp_path / "beside.html"
    assert report(a, b, "--truth", tmp_path / "truth.parquet", "-o", page, "--json", "-q") == ExitCode.DONE
    result = json.loads(capsys.readouterr().out)
    figure = result["figures"]["matched_rmse"]
    assert result["heading"].startswith("B is worse in")
    assert "RMSE of pairs" in result["heading"]
    assert figure["verdict"] == "worse"
    assert figure["low"] < 0.3 < figure["high"]
    assert f"{figure['low']:+.4f} to {figure['high']:+.4f}" in words(page)
    # As `occlog compare` says it
    assert run(["compare", str(a), str(b), "--truth", str(tmp_path / "truth.parquet"), "--json"]) == ExitCode.DONE
    compared = {row["figure"]: row for row in json.loads(capsys.readouterr().out)["rows"]}
    assert compared["matched_rmse"]["low"] == figure["low"]
    assert compared["mota"]["p_holm"] == result["figures"]["mota"]["p"]


def test_without_truth_the_page_says_what_it_can(tmp_path: Path, capsys: Any) -> None:
    a = write_run(tmp_path / "a", tracks())
    b = write_run(tmp_path / "b", tracks(60, lost(2, 30, 44)))
    page = tmp_path / "beside.html"
    files = (a / "tracks.parquet", b / "tracks.parquet")
    assert report(*files, "-o", page, "--json") == ExitCode.DONE
    result = json.loads(capsys.readouterr().out)
    assert (result["a"], result["b"]) == ("a/tracks", "b/tracks")
    assert "figures" not in result
    assert result["first_divergence"]["kind"] == "a alone"
    assert "Only ground truth shows which run is better" in words(page)
    assert "Errors over time" not in words(page)


def test_another_span_of_time_is_reported(tmp_path: Path, capsys: Any) -> None:
    a, b = write_run(tmp_path / "a", tracks(60)), write_run(tmp_path / "b", tracks(40, start=10))
    write_table(tmp_path / "truth.parquet", truth(60), Provenance("simulate"))
    page = tmp_path / "beside.html"
    assert report(a, b, "--truth", tmp_path / "truth.parquet", "-o", page, "-q", "--json") == ExitCode.DONE
    result = json.loads(capsys.readouterr().out)
    assert (result["frames"], result["true_frames"]) == (40, 60)  # the second as `compare` has it
    text = words(page)
    assert "A begins 1 s earlier and A goes on for 1 s longer: the runs are aligned" in text
    assert "in which a run that is not there misses its people" in text
    assert "In 40 common frames" in text
    assert "B is worse in" not in text
    assert "0.6667" in text  # recall of B: 40 of 60 frames


def made_of(folder: Path, *inputs: tuple[str, str]) -> Path:
    """The run folder, its tracks made of these."""
    write_table(
        folder / "tracks.parquet", tracks(), Provenance("track", inputs=inputs), length_unit="m", overwrite=True
    )
    return folder


def test_runs_of_different_recordings_are_reported_so(tmp_path: Path, capsys: Any) -> None:
    one, two, scene = ("hall.mcap", "11" * 32), ("hall.mcap", "22" * 32), ("scene.yaml", "33" * 32)
    a = made_of(write_run(tmp_path / "a", tracks()), ("bearings.parquet", "aa" * 32), one)
    runs = {
        "other": made_of(write_run(tmp_path / "other", tracks()), two),
        "same": made_of(write_run(tmp_path / "same", tracks()), ("bearings.parquet", "bb" * 32), one, two),
        "silent": made_of(write_run(tmp_path / "silent", tracks()), scene),
    }
    for name, run_folder in runs.items():
        page = tmp_path / f"{name}.html"
        assert report(a, run_folder, "-o", page, "--json") == ExitCode.DONE
        notes = json.loads(capsys.readouterr().out).get("notes", [])
        text = "A was made of hall.mcap (11111111), B of another recording, hall.mcap (22222222): differences"
        assert (text in words(page)) == (name == "other")
        assert [note.startswith(text) for note in notes] == ([True] if name == "other" else [])


def far_away(frame: np.ndarray, label: np.ndarray, x: np.ndarray, y: np.ndarray) -> None:
    """Everybody is somewhere else."""
    y += 300.0


def test_a_run_that_is_on_no_one_is_reported_so(runs: tuple[Path, Path], tmp_path: Path, capsys: Any) -> None:
    far = write_run(tmp_path / "far", tracks(60, far_away))
    page = tmp_path / "beside.html"
    assert report(runs[0], far, "-o", page, "--json", "-q") == ExitCode.DONE
    result = json.loads(capsys.readouterr().out)
    assert result["figures"]["recall"]["b"] == 0.0
    assert "b" not in result["figures"]["matched_rmse"]
    assert result["figures"]["matched_rmse"]["verdict"] == "not decided"
    assert "No track of B is ever within 1 m of a true target: is B of the recording that the truth is of?" in words(
        page
    )


def test_settings_change_what_counts(tmp_path: Path, capsys: Any) -> None:
    a, b = write_run(tmp_path / "a", tracks()), write_run(tmp_path / "b", tracks(60, moved(0, 20, 29, 0.6)))
    for more, kind in (
        ((), "apart"),
        (("--divergence-distance", "0.7"), None),
        (("--match-distance", "0.55"), "a alone"),
    ):
        assert report(a, b, "-o", tmp_path / "x.html", "--overwrite", "--json", *more) == ExitCode.DONE
        first = json.loads(capsys.readouterr().out).get("first_divergence")
        assert (None if first is None else first["kind"]) == kind


@pytest.mark.parametrize(
    ("args", "code", "expected"),
    [
        (["a", "none"], ExitCode.BAD_INPUT, "none: no such file"),
        (["a", "empty"], ExitCode.BAD_INPUT, "holds no tracks.parquet"),
        (["a", "truth.parquet"], ExitCode.BAD_INPUT, "truth.parquet: holds truth; expected tracks"),
        (["a", "a/recording.mcap"], ExitCode.USAGE, "is a recording, not tracks"),
        (["a", "later"], ExitCode.BAD_INPUT, "no time in common"),
        (["a", "elsewhere"], ExitCode.BAD_INPUT, "are of different scenes"),
        (["a", "other"], ExitCode.BAD_INPUT, "differs from a/recording.mcap, the truth of the other run"),
        (["a", "nobody"], ExitCode.BAD_INPUT, "holds no estimates"),
        (["a", "feet"], ExitCode.BAD_INPUT, "lengths are in ft, those of a/tracks.parquet in m"),
        (["own", "own"], ExitCode.USAGE, "give --match-distance"),
        (["a", "later", "--bearings", "a/tracks.parquet"], ExitCode.USAGE, "--bearings is an option of a page"),
        (["a", "later", "--png", "x.png"], ExitCode.USAGE, "--png: two runs are shown as a page only"),
        (["a", "later", "--divergence-distance", "0"], ExitCode.USAGE, "0.0"),
        (["a", "later", "third"], ExitCode.USAGE, "third"),
        (["a", "later", "--truth", "a/tracks.parquet"], ExitCode.BAD_INPUT, "holds tracks"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(
    tmp_path: Path, capsys: Any, monkeypatch: Any, args: list[str], code: int, expected: str
) -> None:
    monkeypatch.chdir(tmp_path)
    with_recording(write_run(Path("a"), tracks()))
    write_run(Path("later"), tracks(20, start=80))
    with_recording(write_run(Path("elsewhere"), tracks()), scene=SCENE.replace("[9, 9]", "[9, 12]"))
    with_recording(write_run(Path("other"), tracks()), frames=50)
    write_run(Path("nobody"), PeopleTracks.empty())
    for name, unit in (("feet", "ft"), ("own", "paces")):
        folder = write_run(Path(name), tracks())
        write_table(
            folder / "tracks.parquet",
            tracks(),
            Provenance("track", inputs=(("x", "0"),)),
            length_unit=unit,
            overwrite=True,
        )
    Path("empty").mkdir()
    write_table(Path("truth.parquet"), truth(), Provenance("simulate"))
    assert report(*args, "-o", "beside.html", "--markdown", "beside.md") == code
    err = capsys.readouterr().err
    assert expected in err
    assert "Traceback" not in err
    assert not list(Path().glob("beside.*"))


def test_a_unit_of_its_own_wants_both_lengths(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "own", tracks())
    write_table(folder / "tracks.parquet", tracks(), Provenance("track"), length_unit="paces", overwrite=True)
    given = ("--match-distance", "1", "--divergence-distance", "0.5")
    assert report(folder, folder, "-o", tmp_path / "x.html", "-q", *given) == ExitCode.DONE
    assert report(folder, folder, "-o", tmp_path / "y.html", "-q", *given[:2]) == ExitCode.USAGE


def test_runs_beyond_the_limit_are_refused_and_at_it_they_are_not(
    runs: tuple[Path, Path], tmp_path: Path, monkeypatch: Any, capsys: Any
) -> None:
    monkeypatch.setattr(inputs, "MAX_ROWS", 180)
    assert report(*runs, "-o", tmp_path / "x.html", "-q") == ExitCode.DONE
    monkeypatch.setattr(inputs, "MAX_ROWS", 179)
    assert report(*runs, "-o", tmp_path / "y.html", "-q") == ExitCode.BAD_INPUT
    assert "has 180 estimates, more than the 179" in capsys.readouterr().err


def test_strict_asks_both_runs(tmp_path: Path, capsys: Any) -> None:
    a, b = write_run(tmp_path / "a", tracks()), write_run(tmp_path / "b", tracks(60, moved(0, 0, 59, 0.4)))
    table = tracks(60, moved(0, 0, 59, 0.4))
    true = tracks()
    error = table.y - true.y
    zero = np.zeros(len(error))
    errors = Errors.of(
        t_ns=table.t_ns, target_id=table.target_id, x=table.x, y=table.y, truth_x=true.x, truth_y=true.y,
        error_x=zero, error_y=error, error=np.abs(error), nees=error**2 / 0.0001,
    )  # fmt: skip
    write_table(b / "errors.parquet", errors, Provenance("evaluate"))
    args = ("-o", tmp_path / "x.html", "--overwrite")
    assert report(a, a, *args, "--strict") == ExitCode.DONE
    assert report(a, b, *args) == ExitCode.DONE
    assert "B: warning: report: the covariances are too small" in capsys.readouterr().err
    assert report(a, b, *args, "--strict", "--json") == report(b, a, *args, "--strict", "--json") == ExitCode.THRESHOLD
    result = json.loads(capsys.readouterr().out.splitlines()[0])
    assert result["plausible"] is False
    assert [(w["run"], w["id"]) for w in result["warnings"]] == [("b", "nees-large")]
    assert "B: Not reliable as they are" not in words(tmp_path / "x.html")  # the runs changed places
    assert "A: Not reliable as they are" in words(tmp_path / "x.html")


def test_names_are_the_ends_of_paths_that_tell_runs_apart(tmp_path: Path) -> None:
    for name in ("x/one", "y/one", "x/two"):
        (tmp_path / name).mkdir(parents=True)
    assert names_of(tmp_path / "x/one", tmp_path / "x/two") == ("one", "two")
    assert names_of(tmp_path / "x/one", tmp_path / "y/one") == ("x/one", "y/one")
    assert names_of(Path("a.b/tracks.parquet"), Path("c/tracks.parquet")) == ("a.b/tracks", "c/tracks")


@pytest.mark.parametrize(
    ("args", "kind"),
    [
        (["a"], None),
        (["a", "b"], "beside"),
        (["a", "-o", "b"], None),
        (["a", "-qo", "b"], None),
        (["a", "-ob"], None),
        (["-q", "a", "b", "-o", "c"], "beside"),
        (["a", "--truth=b"], None),
        (["a", "--truth", "b", "c"], "beside"),
        (["a", "--overwrite", "b"], "beside"),
        (["a", "--bearings", "b"], None),
        (["a", "--", "b"], "beside"),
        (["a", "-"], "beside"),
        (["a", "--recording", "b"], None),
        (["a", "--recording", "b", "--video", "c"], "overlay"),
        (["a", "--recording", "b", "--frame", "1"], "overlay"),
    ],
)
def test_two_runs_are_distinguished_from_a_run_with_options(args: list[str], kind: str | None) -> None:
    command = load_command("report")
    assert isinstance(command, VariantCommand)
    assert command.choose(args) == kind
