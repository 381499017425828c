"""Faulty boxes of detectors are left out, counted and listed; the exit code is 3 from a stated share on."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.recording.reader import open_recording
from occlog.records.losses import MINOR_SHARE, OUTSIDE_IMAGE, Loss
from occlog.records.tables import Boxes

HEAD = "frame,left,top,width,height,confidence"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder to work in."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def ingest(lines: list[str], *more: str) -> int:
    Path("b.csv").write_text("\n".join([HEAD, *lines]) + "\n")
    words = ["ingest", "-o", "r.mcap", "--boxes", "cam=b.csv", "--fps", "10", "--allow-uncalibrated", "--overwrite"]
    return run([*words, *more])


def good(frames: int) -> list[str]:
    return [f"{k},{100 + k % 50},50,40,100,0.9" for k in range(frames)]


@pytest.mark.parametrize(
    ("bad", "kind"),
    [
        ("3,10,20,0,40,0.5", "boxes without a size"),
        ("3,10,20,30,-1,0.5", "boxes without a size"),
        ("3,nan,20,30,40,0.5", "boxes without a size"),
        ("3,10,20,30,,0.5", "boxes without a size"),
        ("3,103,50,40,100,0.9", "copies of another box of the frame"),
        *(
            (f"3,10,{far},30,40,0.5", "boxes that reach beyond 1e+06 px")
            for far in ("Infinity", "-inf", "1e9", "1e400")
        ),
        ("3,10,20,inf,40,0.5", "boxes that reach beyond 1e+06 px"),
    ],
)
def test_a_faulty_box_is_left_out_and_listed(bad: str, kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    lines = good(20)
    assert ingest([*lines[:4], bad, *lines[4:]], "--json") == ExitCode.LOSSY
    (loss,) = json.loads(capsys.readouterr().out)["losses"]
    assert (loss["source"], loss["what"], loss["count"], loss["total"]) == ("cam", kind, 1, 21)
    kept = Boxes.concat(open_recording(Path("r.mcap")).tables(Boxes))
    np.testing.assert_array_equal(kept.frame, np.arange(20))
    assert (kept.box == 0).all()


def test_infinite_values_in_json(capsys: pytest.CaptureFixture[str]) -> None:
    boxes = [{"frame": k, "bbox": [100.0 + k, 50, 40, 100 if k else float("inf")]} for k in range(20)]
    Path("b.json").write_text(json.dumps(boxes))
    words = ["ingest", "-o", "r.mcap", "--boxes", "cam=b.json", "--fps", "10", "--allow-uncalibrated", "--json"]
    assert run(words) == ExitCode.LOSSY
    (loss,) = json.loads(capsys.readouterr().out)["losses"]
    assert (loss["what"], loss["count"]) == ("boxes that reach beyond 1e+06 px", 1)


def test_boxes_left_of_images_of_an_unknown_size_are_left_out(capsys: pytest.CaptureFixture[str]) -> None:
    assert ingest(["0,-90,10,40,80,0.9", *good(20)], "--json") == ExitCode.LOSSY
    (loss,) = json.loads(capsys.readouterr().out)["losses"]
    assert (loss["count"], loss["what"].startswith(OUTSIDE_IMAGE)) == (1, True)


def test_a_frame_with_faulty_boxes_alone_is_one_without_a_detection() -> None:
    assert ingest(["0,1,1,0,5,0.5", *good(10)[1:], "10,1,1,5,0,0.5"]) == ExitCode.LOSSY
    kept = Boxes.concat(open_recording(Path("r.mcap")).tables(Boxes))
    assert kept.frame.tolist() == list(range(11))
    assert kept.box.tolist() == [-1, *[0] * 9, -1]


def test_a_few_of_many_end_with_0_unless_none_may_be_lost() -> None:
    few = [*good(2000), "5,1,1,0,5,0.5"]
    assert ingest(few) == ExitCode.DONE
    assert open_recording(Path("r.mcap")).provenance.losses[0].count == 1
    assert ingest(few, "--strict") == ExitCode.LOSSY


@pytest.mark.parametrize(("count", "total", "minor"), [(1, 1000, True), (2, 1000, False), (1, 0, False), (0, 9, False)])
def test_losses_are_minor_up_to_a_share_of_detections(count: int, total: int, minor: bool) -> None:
    assert MINOR_SHARE == 0.001
    assert Loss("cam", "boxes", "faulty", count, total).minor == minor


def test_columns_that_are_no_edges_are_refused_with_the_first_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert ingest(["0,1,1,0,5,0.5", "1,1,1,0,5,0.5", "2,1,1,4,5,0.5"]) == ExitCode.BAD_INPUT
    assert "b.csv: line 2: box of 0 x 5 px; both must be above 0" in capsys.readouterr().err


def test_a_stage_that_loses_nothing_lists_earlier_losses_and_ends_with_0(
    shared_cases: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case = shared_cases / "w05_degenerate_boxes"
    cameras = [word for name in ("c0", "c1", "c2") for word in ("--calibration", str(case / f"{name}.yaml"))]
    words = ["--boxes", str(case / "boxes.csv"), *cameras, "--fps", "10", "--truth", str(case / "truth.csv")]
    assert run(["ingest", "-o", "r.mcap", *words]) == ExitCode.LOSSY
    assert run(["track", "r.mcap", "--method", "sort", "-o", "t.parquet"]) == ExitCode.DONE
    assert "lost earlier: c0: boxes, first line 2: boxes without a size (43 lost)" in capsys.readouterr().err
