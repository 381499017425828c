"""Parts of the benchmark of everybody at once: the evening's baseline, its figures, triangulated groups."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.track import _crowd_baseline as baseline
from benchmarks.track._crowd_cases import Case, write
from benchmarks.track._crowd_trackers import Outcome
from benchmarks.track._left_out import groups, projected
from benchmarks.track.crowd import scored
from occlog.array_types import Floats

FRAMES, FPS = 20, 10.0


def matrix(x: float, y: float, height: float = 3.0) -> Floats:
    """(3, 4) of a camera at (x, y) that points down to the middle of a floor of 10 x 10 m."""
    forward = np.array([5.0 - x, 5.0 - y, -height])
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    turn = np.stack([right, np.cross(forward, right), forward])
    inner = np.array([[800.0, 0.0, 640.0], [0.0, 800.0, 360.0], [0.0, 0.0, 1.0]])
    return np.asarray(inner @ np.column_stack([turn, -turn @ [x, y, height]]))


@pytest.fixture
def walkers() -> Case:
    """Two people who walk 3 m apart, boxes without noise in three cameras."""
    matrices = np.stack([matrix(-1.0, -1.0), matrix(11.0, -1.0), matrix(5.0, 12.0)])
    boxes, truth = [], []
    for frame in range(FRAMES):
        for k, y in enumerate((3.5, 6.5)):
            x = 4.0 + 0.1 * frame
            truth.append((frame, k, x, y))
            for camera, P in enumerate(matrices):
                (u, low), (_, high) = projected(P, np.array([x, y, 0.0])), projected(P, np.array([x, y, 1.7]))
                boxes.append((frame, camera, u - 20.0, high, u + 20.0, low))
    area = (0.0, 10.0, 0.0, 10.0)
    return Case("walkers", FPS, (1280, 720), matrices, np.array(boxes), np.array(truth), area, FRAMES)


def test_the_baseline_follows_people_who_are_seen_plainly(walkers: Case) -> None:
    rows = baseline.followed(baseline.fused(walkers), walkers)
    got = scored(walkers, Outcome(rows, 1.0))
    assert (got["IDF1"], got["MOTA"], got["switches"]) == (1.0, 1.0, 0.0)
    assert got["RMSE [m]"] < 0.1
    assert got["ms a frame"] == pytest.approx(50.0)


def test_one_camera_alone_makes_no_place(walkers: Case) -> None:
    alone = walkers._replace(boxes=walkers.boxes[walkers.boxes[:, 1] == 0])
    assert not len(baseline.fused(alone))


def test_gaps_are_filled_by_straight_lines_without_a_covariance() -> None:
    rows = baseline.filled([(0, 7, 0.0, 0.0, 1.0, 0.0, 1.0), (4, 7, 2.0, 4.0, 1.0, 0.0, 1.0)])
    assert [row[:4] for row in rows] == [(k, 7, 0.5 * k, 1.0 * k) for k in range(5)]
    assert np.isnan(rows[2][4])


def test_boxes_of_the_same_people_make_groups_at_half_their_height(walkers: Case) -> None:
    now = walkers.boxes[walkers.boxes[:, 0] == 0]
    middles = {c: 0.5 * (now[now[:, 1] == c, 2:4] + now[now[:, 1] == c, 4:6]) for c in range(3)}
    positions = sorted(groups(middles, dict(enumerate(walkers.matrices))), key=lambda p: float(p[1]))
    assert len(positions) == 2
    np.testing.assert_allclose(np.array(positions), [[4.0, 3.5, 0.85], [4.0, 6.5, 0.85]], atol=0.15)


def test_files_are_written_as_ingest_reads_them(walkers: Case, tmp_path: Path) -> None:
    write(walkers, tmp_path)
    write(walkers._replace(matrices=walkers.matrices[:2]), tmp_path)
    assert sorted(p.name for p in (tmp_path / "calibration").iterdir()) == ["cam1_P.txt", "cam2_P.txt"]
    assert (tmp_path / "boxes.csv").read_text().startswith("frame,camera,left,top,right,bottom\n0,cam1,")
