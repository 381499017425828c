"""MOTChallenge truth with classes, and results that are empty."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode

BOX = "100,100,40,100"
BESIDE = "300,100,40,100"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder to work in."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def figures(capsys: pytest.CaptureFixture[str], truth: list[str], tracks: list[str], *more: str) -> dict[str, float]:
    Path("gt.txt").write_text("".join(f"{line}\n" for line in truth))
    Path("ours.txt").write_text("".join(f"{line}\n" for line in tracks))
    assert run(["evaluate", "ours.txt", "--truth", "gt.txt", "--json", "-q", *more]) == ExitCode.DONE
    return json.loads(capsys.readouterr().out)  # type: ignore[no-any-return]


def error(capsys: pytest.CaptureFixture[str], truth: list[str], *more: str) -> str:
    Path("gt.txt").write_text("".join(f"{line}\n" for line in truth))
    Path("ours.txt").write_text(f"1,1,{BOX},1,-1,-1,-1\n")
    code = run(["evaluate", "ours.txt", "--truth", "gt.txt", "--json", "-q", *more])
    assert code != ExitCode.DONE
    return capsys.readouterr().err


def counts(got: dict[str, float]) -> tuple[float, ...]:
    return tuple(got[name] for name in ("objects", "tp", "fp", "fn"))


@pytest.mark.parametrize("kind", [2, 7, 8, 12])
def test_a_track_of_a_distractor_is_neither_right_nor_wrong(kind: int, capsys: pytest.CaptureFixture[str]) -> None:
    truth = [f"1,1,{BOX},1,1,1.0", f"1,2,{BESIDE},0,{kind},1.0"]
    tracks = [f"1,5,{BOX},1,-1,-1,-1", f"1,6,{BESIDE},1,-1,-1,-1"]
    got = figures(capsys, truth, tracks)
    assert counts(got) == (1, 1, 0, 0)
    assert (got["tracks_on_distractors"], got["objects_ignored"]) == (1, 1)


@pytest.mark.parametrize("kind", [3, 4, 5, 6, 9, 10, 11, 13])
def test_a_track_of_something_else_is_false_and_the_thing_does_not_count(
    kind: int, capsys: pytest.CaptureFixture[str]
) -> None:
    truth = [f"1,1,{BOX},1,1,1.0", f"1,2,{BESIDE},1,{kind},1.0"]
    tracks = [f"1,5,{BOX},1,-1,-1,-1", f"1,6,{BESIDE},1,-1,-1,-1"]
    assert counts(figures(capsys, truth, tracks)) == (1, 1, 1, 0)


def test_vehicles_without_a_motor_are_distractors_in_mot20_alone(capsys: pytest.CaptureFixture[str]) -> None:
    truth, tracks = [f"1,1,{BOX},1,1,1.0", f"1,2,{BESIDE},1,6,1.0"], [f"1,6,{BESIDE},1,-1,-1,-1"]
    assert counts(figures(capsys, truth, tracks, "--benchmark", "mot20")) == (1, 0, 0, 1)
    assert counts(figures(capsys, truth, tracks, "--benchmark", "mot17")) == (1, 0, 1, 1)


def test_a_pedestrian_marked_zero_does_not_count_and_its_track_is_false(capsys: pytest.CaptureFixture[str]) -> None:
    truth, tracks = [f"1,1,{BOX},1,1,1.0", f"1,2,{BESIDE},0,1,1.0"], [f"1,6,{BESIDE},1,-1,-1,-1"]
    assert counts(figures(capsys, truth, tracks)) == (1, 0, 1, 1)


def test_a_track_meets_a_distractor_from_an_overlap_of_one_half_on(capsys: pytest.CaptureFixture[str]) -> None:
    truth = [f"1,1,{BOX},1,1,1.0", "1,2,300,100,40,100,0,8,1.0"]
    for height, false in ((50, 0), (49, 1)):
        assert figures(capsys, truth, [f"1,6,300,100,40,{height},1,-1,-1,-1"])["fp"] == false


def test_the_nearer_of_pedestrian_and_distractor_has_the_track(capsys: pytest.CaptureFixture[str]) -> None:
    """A track lies on a pedestrian, and nearer to the person on a vehicle next to; another is on the pedestrian."""
    truth = ["1,1,100,100,40,100,1,1,1.0", "1,2,110,100,40,100,0,2,1.0"]
    tracks = ["1,5,100,100,40,100,1,-1,-1,-1", "1,6,108,100,40,100,1,-1,-1,-1"]
    got = figures(capsys, truth, tracks)
    assert counts(got) == (1, 1, 0, 0)
    assert got["tracks_on_distractors"] == 1


def test_a_truth_without_classes_counts_every_row_that_is_not_marked_zero(capsys: pytest.CaptureFixture[str]) -> None:
    truth, tracks = [f"1,1,{BOX},1,-1,-1,-1", f"1,2,{BESIDE},0,-1,-1,-1"], [f"1,5,{BOX},1,-1,-1,-1"]
    got = figures(capsys, truth, tracks)
    assert counts(got) == (1, 1, 0, 0)
    assert "tracks_on_distractors" not in got


def test_classes_can_be_left_alone(capsys: pytest.CaptureFixture[str]) -> None:
    truth, tracks = [f"1,1,{BOX},1,1,1.0", f"1,2,{BESIDE},1,8,1.0"], [f"1,5,{BESIDE},1,-1,-1,-1"]
    assert counts(figures(capsys, truth, tracks, "--benchmark", "mot15")) == (2, 1, 0, 1)


def test_a_frame_in_which_only_distractors_are_is_a_frame(capsys: pytest.CaptureFixture[str]) -> None:
    truth, tracks = [f"1,1,{BOX},1,1,1.0", f"2,2,{BESIDE},0,8,1.0"], [f"2,5,{BOX},1,-1,-1,-1"]
    got = figures(capsys, truth, tracks)
    assert (got["frames"], *counts(got)) == (2, 1, 0, 1, 1)


@pytest.mark.parametrize("kind", [0, 14, -1])
def test_a_class_that_cannot_be_is_named_with_its_line(kind: int, capsys: pytest.CaptureFixture[str]) -> None:
    message = error(capsys, [f"1,1,{BOX},1,1,1.0", f"2,1,{BOX},1,{kind},1.0"])
    assert "gt.txt" in message
    assert "line 2" in message
    assert f"class {kind}" in message


def test_rules_for_classes_want_a_column_of_classes(capsys: pytest.CaptureFixture[str]) -> None:
    assert "has no column of them" in error(capsys, [f"1,1,{BOX},1,-1,-1,-1"], "--benchmark", "mot17")


def test_a_result_without_a_track_misses_everybody(capsys: pytest.CaptureFixture[str]) -> None:
    truth = [f"{frame},1,{BOX},1,1,1.0" for frame in (1, 2, 4)]
    for tracks in ([], ["# nobody"]):
        got = figures(capsys, truth, tracks)
        assert (got["frames"], *counts(got)) == (4, 3, 0, 0, 3)
        assert got["mota"] == got["idf1"] == got["recall"] == 0.0
        assert got["precision"] is None or np.isnan(got["precision"])


def test_a_truth_without_a_row_makes_every_track_false(capsys: pytest.CaptureFixture[str]) -> None:
    got = figures(capsys, [], [f"1,5,{BOX},1,-1,-1,-1", f"3,5,{BOX},1,-1,-1,-1"])
    assert (got["frames"], *counts(got)) == (3, 0, 0, 2, 0)
    assert got["precision"] == got["idp"] == 0.0


def test_an_empty_result_can_be_written_for_other_programs(capsys: pytest.CaptureFixture[str]) -> None:
    figures(capsys, [f"1,1,{BOX},1,1,1.0"], [], "--mot", "mot", "-o", "m.json", "--failures", "f.parquet")
    assert Path("mot/trackers/MOT17-train/ours/data/view.txt").read_text() == ""


def test_boxes_that_do_not_count_are_stated_by_class(capsys: pytest.CaptureFixture[str]) -> None:
    truth = [f"1,1,{BOX},1,1,1.0", f"1,2,{BESIDE},1,2,1.0", "1,3,5,5,9,9,1,2,1.0", "1,4,50,5,9,9,0,7,1.0"]
    Path("gt.txt").write_text("".join(f"{line}\n" for line in truth))
    Path("ours.txt").write_text(f"1,1,{BOX},1,-1,-1,-1\n")
    assert run(["evaluate", "ours.txt", "--truth", "gt.txt"]) == ExitCode.DONE
    stderr = capsys.readouterr().err
    assert "3 of 4 true boxes do not count by the rules of mot17 (class 2: 2, class 7: 1)" in stderr
    assert "--benchmark mot15 counts all boxes" in stderr


def test_a_truth_with_zeros_in_column_7_alone_is_refused_with_what_to_write(capsys: pytest.CaptureFixture[str]) -> None:
    message = error(capsys, [f"1,1,{BOX},0,1,1.0", f"2,1,{BOX},0,1,1.0"])
    assert "(class 1, with 0 in column 7: 2)" in message
    assert "write 1 there to count them" in message


def test_a_truth_in_which_no_box_counts_is_refused_with_its_class(capsys: pytest.CaptureFixture[str]) -> None:
    message = error(capsys, [f"1,1,{BOX},1,2,1.0", f"2,1,{BOX},1,2,1.0"])
    assert "all 2 true boxes are skipped by the rules of mot17 (class 2: 2)" in message
    assert "count them with --benchmark mot15" in message


@pytest.mark.parametrize(("truth", "rows"), [("gt_mixed.txt", 300), ("gt_class2.txt", 300)])
def test_classes_of_annotation_tools_count_by_the_rules_without_classes(
    truth: str, rows: int, shared_cases: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = shared_cases / "v09-mot-classes-of-cvat"
    words = [
        "evaluate",
        str(files / "tracks.txt"),
        "--truth",
        str(files / truth),
        "--benchmark",
        "mot15",
        "--json",
        "-q",
    ]
    assert run(words) == ExitCode.DONE
    got = json.loads(capsys.readouterr().out)
    assert (got["mota"], got["objects"]) == (1.0, rows)
