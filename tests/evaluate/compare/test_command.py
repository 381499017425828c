"""`occlog compare`: runs that differ, runs that do not, and inputs that cannot be compared."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.records.losses import Loss
from occlog.records.tables import Tracks, Truth

STEP = 100_000_000
PEOPLE = 4


def places(seed: int, frames: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, people, and where they walk: far from each other."""
    rng = np.random.default_rng(seed)
    t = np.repeat(np.arange(frames), PEOPLE)
    who = np.tile(np.arange(PEOPLE), frames)
    walk = np.cumsum(rng.normal(0, 0.05, (frames, PEOPLE, 2)), axis=0).reshape(-1, 2)
    return t, who, walk + 100 * who[:, None]


def write(
    folder: Path, seed: int, *, noise: float = 0.1, lost: float = 0.0, frames: int = 400, tracker: int = 0
) -> Path:
    """A run folder with a table of truth next to it."""
    t, who, xy = places(seed, frames)
    rng = np.random.default_rng([seed, tracker])
    folder.mkdir(parents=True, exist_ok=True)
    # Whole stretches of 1.2 s, which are not bridged
    kept = rng.random((frames // 12 + 1, PEOPLE))[t // 12, who] >= lost
    found = xy + rng.normal(0, noise, xy.shape)
    cov, nothing = np.full(len(t), noise**2), np.full(len(t), np.nan)
    tracks = Tracks.of(
        t_ns=t * STEP, target_id=who, x=found[:, 0], y=found[:, 1], vx=nothing, vy=nothing,
        cov_xx=cov, cov_xy=0 * cov, cov_yy=cov,
    ).take(kept)  # fmt: skip
    truth = Truth.of(
        t_ns=t * STEP, target_id=who, role=np.full(len(t), "target"), x=xy[:, 0], y=xy[:, 1], z=nothing
    )  # fmt: skip
    write_table(folder / "tracks.parquet", tracks, Provenance("track"), overwrite=True)
    write_table(folder / "truth.parquet", truth, Provenance("simulate"), overwrite=True)
    return folder


def report_of(capsys: pytest.CaptureFixture[str]) -> dict[str, dict[str, object]]:
    found = json.loads(capsys.readouterr().out)
    return {row["figure"]: row for row in found["rows"]}


def compared(*paths: Path, more: tuple[str, ...] = ()) -> int:
    return run(["compare", *map(str, paths), *more])


def test_a_run_that_is_worse_is_found_and_fails(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a, b = write(tmp_path / "a", 1), write(tmp_path / "b", 1, noise=0.2, tracker=1)
    truth = ("--truth", str(a / "truth.parquet"))
    assert compared(a, b, more=(*truth, "--json")) == ExitCode.DONE
    rows = report_of(capsys)
    assert set(rows) == {"idf1", "hota", "mota", "recall", "precision", "matched_rmse"}
    assert rows["matched_rmse"]["first"] == pytest.approx(0.1 * np.sqrt(2), rel=0.05)
    assert rows["matched_rmse"]["this"] == pytest.approx(0.2 * np.sqrt(2), rel=0.05)
    assert rows["matched_rmse"]["verdict"] == "worse"
    assert rows["hota"]["verdict"] == "not decided"  # of identities one recording says nothing
    assert rows["mota"]["difference"] == rows["idf1"]["difference"] == 0.0
    assert rows["mota"]["verdict"] == "no difference shown"
    low, high = rows["matched_rmse"]["low"], rows["matched_rmse"]["high"]
    assert low < 0.1 * np.sqrt(2) < high  # type: ignore[operator]
    figures = ("--metric", "mota", "--metric", "matched_rmse")
    fine = ("--fail-if", "mota worse", "--fail-if", "matched_rmse worse by 0.15")
    assert compared(a, b, more=(*truth, *figures, *fine)) == ExitCode.DONE
    for bad in ("hota worse", "matched_rmse worse by 0.1"):
        assert compared(a, b, more=(*truth, *figures, *fine, "--fail-if", bad)) == ExitCode.THRESHOLD
    assert compared(b, a, more=(*truth, "--fail-if", "matched_rmse worse")) == ExitCode.DONE
    stderr = capsys.readouterr().err
    assert "--fail-if matched_rmse worse by 0.1: method 2 has 0.28" in stderr
    assert "--fail-if hota worse: method 2: not decided; identities that were exchanged stay so" in stderr


def test_lost_people_lower_idf1_and_mota(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a, b = write(tmp_path / "a", 1, frames=1800), write(tmp_path / "b", 1, lost=0.3, tracker=1, frames=1800)
    more = ("--truth", str(a / "truth.parquet"), "--json", "--match-distance", "0.8")
    assert compared(a, b, more=more) == ExitCode.DONE
    rows = report_of(capsys)
    assert rows["recall"]["this"] == pytest.approx(0.7, abs=0.12)
    assert rows["recall"]["verdict"] == rows["mota"]["verdict"] == "worse"
    assert rows["idf1"]["difference"] < -0.1  # type: ignore[operator]
    assert rows["mota"]["difference"] == pytest.approx(rows["recall"]["difference"])
    assert rows["matched_rmse"]["verdict"] == "no difference shown"


def test_folders_of_runs_are_paired_by_name_and_recordings_are_drawn(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truths = tmp_path / "truths"
    truths.mkdir()
    for k in range(10):
        for method, noise in (("old", 0.1), ("new", 0.12)):
            made = write(
                tmp_path / method / "runs" / f"r{k}", k, noise=noise, frames=40, tracker=k + 50 * (method == "new")
            )
            (made / "truth.parquet").replace(truths / f"r{k}.parquet")
    page = tmp_path / "c.md"
    paths = (tmp_path / "old", tmp_path / "new")
    more = ("--truth", str(truths), "--markdown", str(page), "--metric", "matched_rmse", "--metric", "hota")
    assert compared(*paths, more=more) == ExitCode.DONE
    stdout = capsys.readouterr().out
    assert "400 frames of 10 recordings; 10 recordings exchanged" in stdout
    assert stdout.count("  worse\n") == 2
    assert "| matched_rmse | " in page.read_text()
    assert compared(*paths, more=more) == ExitCode.EXISTS
    (tmp_path / "new/runs/r3/tracks.parquet").unlink()
    assert compared(*paths, more=("--truth", str(truths))) == ExitCode.BAD_INPUT
    assert "holds no run of runs/r3" in capsys.readouterr().err


def folders(tmp_path: Path, count: int, **methods: float) -> tuple[Path, ...]:
    """Run folders of methods that lose such a share of people, on as many recordings, with `truths` next to them."""
    (tmp_path / "truths").mkdir()
    for k in range(count):
        for m, (method, lost) in enumerate(methods.items()):
            made = write(tmp_path / method / f"r{k}", k, lost=lost, frames=40, tracker=k + 50 * m)
            (made / "truth.parquet").replace(tmp_path / "truths" / f"r{k}.parquet")
    return tuple(tmp_path / method for method in methods)


def test_a_check_of_more_methods_than_its_recordings_can_tell_apart_does_not_pass(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = folders(tmp_path, 8, first=0.3, b=0.0, c=0.0, d=0.0)
    more = ("--truth", str(tmp_path / "truths"), "--fail-if", "mota worse", "--metric", "mota", "--json")
    # All of eight recordings are better by chance once in 256 times: more than a half of 1 %, less than a third
    assert compared(*paths[:3], more=more) == ExitCode.DONE
    assert compared(*paths, more=more) == ExitCode.THRESHOLD
    assert "not decided; of 8 recordings nothing can be shown of 3 methods" in capsys.readouterr().err
    # Either way it is 2 of 256, and of seven rows together more than 5 %
    wide = ("--truth", str(tmp_path / "truths"), "--json")
    chosen = tuple(word for name in ("mota", "idf1", "hota", "recall") for word in ("--metric", name))
    assert compared(*paths[:3], more=(*wide, *chosen)) == ExitCode.DONE
    assert report_of(capsys)["mota"]["verdict"] == "not decided"


def test_short_recordings_are_not_decided_and_fail_as_that(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a, b = write(tmp_path / "a", 1, frames=8), write(tmp_path / "b", 1, noise=0.3, frames=8, tracker=1)
    more = ("--truth", str(a / "truth.parquet"))
    assert compared(a, b, more=(*more, "--fail-if", "matched_rmse worse")) == ExitCode.THRESHOLD
    captured = capsys.readouterr()
    assert "not decided" in captured.out
    assert "fewer than 20" in captured.err


def test_a_run_that_meets_no_one_has_no_error_to_be_compared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    a, b = write(tmp_path / "a", 1, frames=200), write(tmp_path / "b", 1, noise=0.0, frames=200)
    far = read_table(b / "tracks.parquet", Tracks)
    far.x[:] += 5000.0
    write_table(b / "tracks.parquet", far, Provenance("track"), overwrite=True)
    assert compared(a, b, more=("--truth", str(a / "truth.parquet"), "--json")) == ExitCode.DONE
    rows = report_of(capsys)
    assert (rows["matched_rmse"]["this"], rows["matched_rmse"]["verdict"]) == (None, "not decided")
    assert (rows["recall"]["this"], rows["recall"]["difference"]) == (0.0, -1.0)


def test_a_truth_of_another_clock_is_refused_and_no_tracks_are_a_result(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    a, b = write(tmp_path / "a", 1, frames=200), write(tmp_path / "b", 1, frames=200, tracker=1)
    none = read_table(b / "tracks.parquet", Tracks).take(np.zeros(0, dtype=np.int64))
    write_table(b / "tracks.parquet", none, Provenance("track"), overwrite=True)
    assert compared(a, b, more=("--truth", str(a / "truth.parquet"), "--json")) == ExitCode.DONE
    assert report_of(capsys)["recall"]["this"] == 0.0
    other = read_table(a / "truth.parquet", Truth)
    for clock in (1_577_836_800 * 10**9, -(10**12)):
        moved = Truth.of(**{c.name: getattr(other, c.name) for c in Truth.columns()} | {"t_ns": other.t_ns + clock})
        write_table(tmp_path / "moved.parquet", moved, Provenance("simulate"), overwrite=True)
        assert compared(a, b, more=("--truth", str(tmp_path / "moved.parquet"))) == ExitCode.BAD_INPUT
        captured = capsys.readouterr()
        assert "no estimate is from the time of the truth" in captured.err
        assert "check the clocks" in captured.err
        assert captured.out == ""


def test_what_cannot_be_compared_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a, b = write(tmp_path / "a", 1, frames=30), write(tmp_path / "b", 2, frames=30)
    truth = ("--truth", str(a / "truth.parquet"))
    (tmp_path / "empty").mkdir()
    for paths, more, code, words in (
        ((a,), truth, ExitCode.USAGE, "name at least two methods"),
        ((a, b), (), ExitCode.USAGE, "give --truth"),
        ((a, tmp_path / "empty"), truth, ExitCode.BAD_INPUT, "holds no tracks.parquet"),
        ((a, tmp_path / "none.parquet"), truth, ExitCode.BAD_INPUT, "no such file"),
        ((a, b), (*truth, "--fail-if", "idf2 worse"), ExitCode.USAGE, "there is no figure 'idf2'"),
        ((a, b), (*truth, "--metric", "idf2"), ExitCode.USAGE, "there are idf1, hota"),
        ((a, b), (*truth, "--fail-if", "idf1 worse by -1"), ExitCode.USAGE, "must be 'FIGURE worse'"),
        ((a, b), ("--truth", str(b / "tracks.parquet")), ExitCode.BAD_INPUT, "holds tracks"),
    ):
        assert compared(*paths, more=more) == code, words
        stderr = capsys.readouterr().err
        assert words in stderr
        assert stderr.count("\n") <= 4


def test_truths_of_two_methods_must_have_the_same_rows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, seed, tracker in (("a", 1, 0), ("b", 2, 0), ("c", 1, 1)):
        folder = write(tmp_path / name, seed, frames=30, tracker=tracker)
        (folder / "truth.parquet").rename(folder / "recording.mcap")
    assert compared(tmp_path / "a", tmp_path / "b") == ExitCode.BAD_INPUT
    assert "the truth of the first method" in capsys.readouterr().err
    lost = Provenance("simulate", losses=(Loss("cam", "frame 3", "gone", 1),))
    again = tmp_path / "again.parquet"
    write_table(again, read_table(tmp_path / "c/recording.mcap", Truth), lost)
    again.replace(tmp_path / "c/recording.mcap")
    assert compared(tmp_path / "a", tmp_path / "c") == ExitCode.DONE
    assert "lost earlier: cam: frame 3: gone" in capsys.readouterr().err


def test_tables_of_others_are_brought_to_the_unit_of_the_first(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    a, b = write(tmp_path / "a", 1), write(tmp_path / "b", 1, tracker=1)
    found, true = read_table(b / "tracks.parquet", Tracks), read_table(a / "truth.parquet", Truth)
    in_cm = [tmp_path / "b.csv", tmp_path / "truth.csv"]
    for path, rows in zip(in_cm, (found, true), strict=True):
        columns = zip(rows.t_ns, rows.target_id, 100 * rows.x, 100 * rows.y, strict=True)
        text = "".join(f"{t},{k},{float(x)!r},{float(y)!r}\n" for t, k, x, y in columns)
        path.write_text("t_ns,id,x_cm,y_cm\n" + text)
    assert compared(a, b, more=("--truth", str(a / "truth.parquet"), "--json")) == ExitCode.DONE
    ours = report_of(capsys)
    for truth in (a / "truth.parquet", in_cm[1]):
        assert compared(a / "tracks.parquet", in_cm[0], more=("--truth", str(truth), "--json")) == ExitCode.DONE
        assert report_of(capsys)["matched_rmse"]["this"] == pytest.approx(ours["matched_rmse"]["this"], rel=1e-9)


def test_runs_in_folders_of_one_name_have_truths_of_their_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for k, site in enumerate(("hall", "yard")):
        for method in ("a", "b"):
            made = write(tmp_path / method / site / "walk", k, tracker=int(method == "b"), frames=60)
        (tmp_path / "truths" / site).mkdir(parents=True)
        (made / "truth.parquet").replace(tmp_path / "truths" / site / "walk.parquet")
    (tmp_path / "truths" / "walk.parquet").write_bytes((tmp_path / "truths/hall/walk.parquet").read_bytes())
    more = ("--truth", str(tmp_path / "truths"), "--json")
    assert compared(tmp_path / "a", tmp_path / "b", more=more) == ExitCode.DONE
    assert report_of(capsys)["matched_rmse"]["this"] == pytest.approx(0.14, abs=0.02)
