"""The parts of the comparison with trackers of other projects that need none of them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.images._views_score import LabelledBoxes, around, figures, inside
from benchmarks.peers import _views_peer as peer
from benchmarks.peers import views_peer

SIDE = 10.0


def placed(*rows: tuple[int, int, int, float, float]) -> LabelledBoxes:
    """Boxes of side 10 from view, frame, label and centre."""
    view, frame, label, x, y = np.array(rows, dtype=np.float64).T
    box = np.column_stack([x - 0.5 * SIDE, y - 0.5 * SIDE, np.full((len(x), 2), SIDE)])
    return LabelledBoxes(view.astype(np.int64), frame.astype(np.int64), label.astype(np.int64), box)


def still(frames: int) -> LabelledBoxes:
    """Targets 7 at x = 20 and 8 at x = 60."""
    return placed(*[(0, k, label, x, 50.0) for k in range(frames) for label, x in ((7, 20.0), (8, 60.0))])


@pytest.mark.parametrize("rho", [-1.2, 0.0, 0.7])
def test_box_around_ellipse_touches_its_outline(rho: float) -> None:
    turn = np.linspace(0.0, 2.0 * np.pi, 20001)
    along, across = 9.0 * np.cos(turn), 4.0 * np.sin(turn)
    x = 30.0 + along * np.cos(rho) - across * np.sin(rho)
    y = 50.0 + along * np.sin(rho) + across * np.cos(rho)
    box = around(np.array([[30.0, 50.0, 9.0, 4.0, rho]]))[0]
    np.testing.assert_allclose(box, [x.min(), y.min(), np.ptp(x), np.ptp(y)], atol=1e-5)


def test_boxes_outside_and_without_size_do_not_count() -> None:
    given = placed((0, 0, 1, 4.0, 50.0), (0, 0, 2, -6.0, 50.0), (1, 0, 3, 104.0, 50.0), (1, 0, 4, 90.0, 50.0))
    given.box[3, 2] = 0.0
    size = np.array([[100, 100], [200, 100]])[given.view]
    assert inside(given, size).label.tolist() == [1, 3]


def test_tracks_under_other_names_are_perfect() -> None:
    truth = still(5)
    got = figures(truth, truth._replace(label=107 - truth.label))
    assert got["fr_p"] == got["fr_l"] == got["switches"] == 0
    assert got["idf1"] == got["mota"] == 1
    assert got["hota"] == pytest.approx(1)


def test_tracks_that_change_places_and_one_that_ends() -> None:
    # Frames 0, 1: as they should; 2, 3: each on the other's target; 4: only one is left, on the wrong one.
    rows = [(0, k, label, x, 50.0) for k in range(2) for label, x in ((1, 20.0), (2, 60.0))]
    rows += [(0, k, label, x, 50.0) for k in (2, 3) for label, x in ((2, 20.0), (1, 60.0))]
    got = figures(still(5), placed(*rows, (0, 4, 2, 20.0, 50.0)))
    assert got["fr_p"] == pytest.approx(1 / 10)
    assert got["fr_l"] == pytest.approx(5 / 10)
    assert got["switches"] == 2


def test_track_that_begins_on_nothing_belongs_to_the_first_target_it_meets() -> None:
    rows = [(0, 0, 1, 90.0, 90.0), (0, 1, 1, 22.0, 50.0), (0, 2, 1, 20.0, 50.0), (0, 3, 1, 58.0, 50.0)]
    got = figures(still(4), placed(*rows))
    assert got["fr_p"] == pytest.approx((2 + 1 + 1 + 1) / 8)
    assert got["fr_l"] == pytest.approx(1 / 8)


def test_labels_of_two_views_are_one_identity_only_where_asked() -> None:
    truth = placed(*[(v, k, label, x, 50.0) for v in (0, 1) for k in (0, 1) for label, x in ((7, 20.0), (8, 60.0))])
    crossed = np.where(truth.view == 1, 15 - truth.label, truth.label)
    got = figures(truth, truth._replace(label=crossed))
    assert got["fr_l"] == 0
    assert got["fr_l joint"] == pytest.approx(1 / 2)


def test_every_view_is_tracked_alone_and_in_all_frames() -> None:
    given = placed((1, 0, 0, 20.0, 50.0), (1, 2, 0, 24.0, 50.0), (0, 1, 0, 60.0, 50.0))
    boxes = {"view": given.view, "frame": given.frame, "box": given.box}
    steps: list[int] = []

    def step(corners: np.ndarray) -> tuple[list[int], np.ndarray]:
        steps.append(len(corners))
        return list(range(len(corners))), corners + 1.0

    rows = list(peer.tracked(1, boxes, 4, step))
    assert steps == [1, 0, 1, 0]
    assert [row[:3] for row in rows] == [(1, 0, 0), (1, 2, 0)]
    np.testing.assert_allclose(rows[0][3], [16.0, 46.0, 10.0, 10.0])


def test_peer_writes_what_the_comparison_reads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    given = still(3)
    np.savez(tmp_path / "in.npz", frames=[3], fps=25.0, view=given.view, frame=given.frame, box=given.box)
    echo = ("numpy", lambda _: lambda corners: (range(len(corners)), corners))
    monkeypatch.setitem(peer.MAKERS, "echo", echo)
    peer.main(str(tmp_path / "in.npz"), str(tmp_path / "out.npz"), "echo")
    got = np.load(tmp_path / "out.npz")
    tracks = LabelledBoxes(*(got[name] for name in LabelledBoxes._fields))
    assert figures(given, tracks)["idf1"] == 1
    assert set(json.loads(capsys.readouterr().out)) == {"seconds", "version"}


def test_numbers_for_a_person() -> None:
    assert views_peer.seeds("1-4") == [1, 2, 3, 4]
    assert views_peer.seeds("3,9") == [3, 9]
    assert views_peer.cell("fr_p", [0.25]) == "0.250"
    assert views_peer.cell("idf1", [0.4, 0.6]) == "0.500 ± 0.100"
    assert views_peer.cell("fps", [100.0, 300.0]) == "200"
    assert views_peer.cell("fr_l joint", [np.nan]) == "–"
