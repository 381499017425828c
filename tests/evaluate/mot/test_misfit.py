"""Tracks in images of another size, other frames or another format are named where hardly any box fits."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from occlog.cli.main import run
from occlog.evaluate.mot.misfit import SampledBoxes, misfit

Change = Callable[[np.ndarray], np.ndarray]


def rows(seed: int) -> np.ndarray:
    """(N, 6) frame, identity, left, top, width, height of four people who walk through an image."""
    rng = np.random.default_rng(seed)
    start, pace = rng.uniform([100.0, 100.0], [900.0, 300.0], (4, 2)), rng.uniform(0.0, 6.0, (4, 2))
    out = [
        (frame, person + 1, *(start[person] + pace[person] * frame), 60.0, 150.0)
        for frame in range(40, 100)
        for person in range(4)
    ]
    return np.array(out)


def evaluated(folder: Path, tracks: np.ndarray, truth: np.ndarray, capsys: pytest.CaptureFixture[str]) -> list[str]:
    """Messages of the warnings of `evaluate`."""
    for name, table, end in (("tracks.txt", tracks, "1,-1,-1,-1"), ("gt.txt", truth, "1,1,1")):
        lines = [",".join([f"{row[0]:.0f}", f"{row[1]:.0f}", *(f"{v:.2f}" for v in row[2:]), end]) for row in table]
        (folder / name).write_text("\n".join(lines) + "\n")
    run(["evaluate", str(folder / "tracks.txt"), "--truth", str(folder / "gt.txt"), "--json"])
    found = json.loads(capsys.readouterr().out)
    assert {each["id"] for each in found["warnings"]} <= {"boxes-fit-if"}
    return [each["message"] for each in found["warnings"]]


def scaled(tracks: np.ndarray) -> np.ndarray:
    return np.column_stack([tracks[:, :2], tracks[:, 2:] / 1.5])


def shifted(tracks: np.ndarray) -> np.ndarray:
    return np.column_stack([tracks[:, 0] - 30.0, tracks[:, 1:]])


def corners(tracks: np.ndarray) -> np.ndarray:
    return np.column_stack([tracks[:, :4], tracks[:, 2:4] + tracks[:, 4:]])


def centres(tracks: np.ndarray) -> np.ndarray:
    return np.column_stack([tracks[:, :2], tracks[:, 2:4] + 0.5 * tracks[:, 4:], tracks[:, 4:]])


def exchanged(tracks: np.ndarray) -> np.ndarray:
    return tracks[:, [0, 1, 3, 2, 5, 4]]


def every_third(tracks: np.ndarray) -> np.ndarray:
    kept = tracks[tracks[:, 0] % 3 == 0]
    return np.column_stack([kept[:, 0] // 3, kept[:, 1:]])


def mirrored(tracks: np.ndarray) -> np.ndarray:
    return np.column_stack([tracks[:, :2], 1920.0 - tracks[:, 2] - tracks[:, 4], tracks[:, 3:]])


def from_below(tracks: np.ndarray) -> np.ndarray:
    return np.column_stack([tracks[:, :3], 1080.0 - tracks[:, 3] - tracks[:, 5], tracks[:, 4:]])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (exchanged, "x and y exchanged"),
        (lambda tracks: tracks[:, [1, 0, 2, 3, 4, 5]], "frame numbers and identities exchanged"),
        (every_third, "frame numbers multiplied by 3"),
        (mirrored, "images mirrored"),
        (from_below, "y counted from below"),
        (scaled, "boxes multiplied by 1.5 (images of another size)"),
        (shifted, "frame numbers +30"),
        (corners, "right and lower edges for width and height (xyxy for xywh)"),
        (centres, "the centre for the left upper corner"),
        (
            lambda tracks: scaled(shifted(tracks)),
            "boxes multiplied by 1.5 (images of another size) and frame numbers +30",
        ),
    ],
)
def test_what_makes_boxes_fit_is_named(
    change: Change, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth = rows(1)
    (text,) = evaluated(tmp_path, change(truth), truth, capsys)
    assert f", 100% if tracks are changed ({words}); " in text


def test_nothing_is_reported_of_tracks_that_fit_or_of_other_objects(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth = rows(2)
    assert evaluated(tmp_path, truth, truth, capsys) == []
    assert evaluated(tmp_path, rows(3), truth, capsys) == []


@pytest.mark.parametrize("step", [1, 5])
def test_a_truth_of_key_frames_is_named(step: int) -> None:
    frame = np.repeat(np.arange(1, 101), 2)
    ltwh = np.column_stack([100.0 * (np.arange(200) % 2), frame, np.full(200, 50.0), np.full(200, 90.0)])
    tracks = SampledBoxes(frame, np.zeros(200, np.int64), np.arange(200) % 2, ltwh)
    known = (frame - 1) % step == 0
    truth = SampledBoxes(*(column[known] for column in tracks))
    ids = [check.id for check in misfit(tracks, truth, {"mota": -3.0}) if check.found]
    assert ids == (["truth-frames-in-steps"] if step > 1 else [])
