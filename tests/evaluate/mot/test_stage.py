"""Tracks of many targets against the truth, on scenes that are worked by hand."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from occlog.errors import InputError
from occlog.evaluate.mot.config import MultiTargetConfig
from occlog.evaluate.mot.stage import ComparedBoxes
from occlog.evaluate.results import Evaluation
from occlog.records.declared.views import Failures, ViewTracks, boxes_of_ellipses
from occlog.records.tables import Boxes, TruthBoxes

NS = 1_000_000_000
FRAMES = 10
Row = tuple[int, str, int, float, float]
"""Frame, camera, identity, left, top of a box of 20 x 20."""


def evaluate_boxes(
    tracks: Boxes, truth: TruthBoxes, config: MultiTargetConfig | None = None, **options: bool
) -> Evaluation:
    """Figures of tables that have yet to be laid against each other."""
    failures: list[Failures] = []
    compared = ComparedBoxes(lambda: iter([(tracks, truth)]), config or MultiTargetConfig(), **options)
    return replace(compared.evaluate(failures.append), failures=Failures.concat(failures))


def table(kind: type[Boxes], rows: list[Row], **more: Any) -> Any:
    frame, sensor, target, left, top = (list(column) for column in zip(*sorted(rows), strict=True))
    n = len(rows)
    return kind.of(
        t_ns=np.array(frame) * NS,
        sensor=sensor,
        frame=frame,
        box=np.arange(n, dtype=np.int32),
        target_id=np.array(target, np.int32),
        left_px=left,
        top_px=top,
        width_px=np.full(n, 20.0),
        height_px=np.full(n, 20.0),
        confidence=np.full(n, np.nan),
        **more,
    )


def true_rows() -> list[Row]:
    """Two targets, 100 px apart, in two views."""
    return [(f, view, k, 100.0 * k, 5.0 * f) for f in range(FRAMES) for view in ("a", "b") for k in (1, 2)]


def tracked_rows() -> list[Row]:
    """The trackers of view a swap after six frames; target 2 is lost in view b in the last two."""
    rows = []
    for f, view, k, left, top in true_rows():
        if view == "b" and k == 2 and f >= 8:
            continue
        rows.append((f, view, 3 - k if view == "a" and f >= 6 else k, left, top))
    return rows


def truth() -> TruthBoxes:
    return table(TruthBoxes, true_rows(), visible=np.tile([1.0, 0.4], 2 * FRAMES))  # type: ignore[no-any-return]


def test_a_swap_in_one_view_and_a_lost_tracker_in_the_other() -> None:
    got = evaluate_boxes(table(Boxes, tracked_rows()), truth()).metrics
    counts = {
        "objects": 40,
        "estimates_compared": 38,
        "frames": 20,
        "position_failures": 2,
        "label_failures": 8,
        "tp": 38,
        "fn": 2,
        "fp": 0,
        "id_switches": 2,
        "fragmentations": 0,
        "idtp": 30,
        "targets": 4,
        "tracks": 4,
        "mostly_tracked": 4,
        "mostly_lost": 0,
        "frames_without_tracks": 0,
        "views_without_tracks": 0,
    }
    assert {name: got[name] for name in counts} == counts
    rates = {
        "fr_p": 2 / 40,
        "fr_l": 8 / 40,
        "mota": 1 - 4 / 40,
        "motp": 0.0,
        "motp_iou": 1.0,
        "recall": 38 / 40,
        "precision": 1.0,
        "idf1": 60 / 78,
        "idf1_across_views": 60 / 78,
        "loca": 1.0,
        "fr_l_sensor_a": 8 / 20,
        "fr_p_sensor_a": 0.0,
        "fr_p_sensor_b": 2 / 20,
        "mota_sensor_a": 1 - 2 / 20,
        "idf1_sensor_a": 0.6,
        "idf1_sensor_b": 36 / 38,
        "deta_sensor_b": 18 / 20,
        "gospa": 2 * math.sqrt(0.125) / 20,
        "gospa_missed": 2 * 0.125 / 20,
        "gospa_localisation": 0.0,
    }
    assert {name: got[name] for name in rates} == pytest.approx(rates)


def test_each_failure_is_a_row() -> None:
    found = evaluate_boxes(table(Boxes, tracked_rows()), truth()).failures
    rows = list(
        zip(
            found.frame.tolist(),
            found.sensor.tolist(),
            found.target_id.tolist(),
            found.kind.tolist(),
            found.other_id.tolist(),
            found.cause.tolist(),
            found.visible.tolist(),
            strict=True,
        )
    )
    assert rows[:3] == [
        (6, "a", 1, "label", 2, "tracker on target 2", 1.0),
        (6, "a", 2, "label", 1, "tracker on target 1", 0.4),
        (7, "a", 1, "label", 2, "tracker on target 2", 1.0),
    ]
    assert (8, "b", 2, "position", -1, "no tracker", 0.4) in rows
    assert len(rows) == 10
    np.testing.assert_array_equal(found.t_ns, found.frame * NS)


def test_how_near_a_tracker_must_be() -> None:
    """Trackers are 9 px next to targets of radius 10."""
    beside = [(f, view, k, left + 9.0, top) for f, view, k, left, top in true_rows()]
    tracks = table(Boxes, beside)
    assert evaluate_boxes(tracks, truth()).metrics["fr_p"] == 0.0
    assert evaluate_boxes(tracks, truth(), MultiTargetConfig(distance_gate=0.9)).metrics["fr_p"] == 0.0
    assert evaluate_boxes(tracks, truth(), MultiTargetConfig(distance_gate=0.89)).metrics["fr_p"] == 1.0
    got = evaluate_boxes(tracks, truth(), MultiTargetConfig(distance_gate_px=8.0, gospa_px=20.0))
    assert got.metrics["fr_p"] == 1.0
    assert got.failures.cause[0] == "its tracker is 9 px away"
    assert got.metrics["gospa_px"] == pytest.approx(math.sqrt(2 * 81.0))
    assert got.metrics["gospa_localisation_px2"] == pytest.approx(2 * 81.0)
    assert got.metrics["tp"] == 0  # an overlap of 11 of 29
    assert evaluate_boxes(tracks, truth(), MultiTargetConfig(match_iou=11 / 29)).metrics["tp"] == 40


@pytest.mark.parametrize("own", ["start", "optimal"])
def test_tracks_with_names_of_their_own(own: str) -> None:
    renamed = [(f, view, 90 - k, left, top) for f, view, k, left, top in tracked_rows()]
    named = evaluate_boxes(table(Boxes, tracked_rows()), truth())
    got = evaluate_boxes(table(Boxes, renamed), truth(), MultiTargetConfig(assigned_target=own))
    for name in ("fr_p", "fr_l", "mota", "idf1", "hota"):
        assert got.metrics[name] == named.metrics[name]
    assert not got.notes
    assert got.failures.target_id.tolist() == named.failures.target_id.tolist()
    strange = evaluate_boxes(table(Boxes, renamed), truth())
    assert strange.metrics["fr_l"] == 38 / 40
    assert "no track has the number of a target (88, 89; 1, 2)" in strange.notes[0]


def test_a_track_that_begins_on_nothing_belongs_to_the_first_target_it_is_on() -> None:
    early = [(f, "a", 7, 100.0 if f >= 2 else 400.0, 5.0 * f) for f in range(FRAMES)]
    again = [(f, "a", 8, 200.0, 5.0 * f) for f in range(4)] + [(f, "a", 9, 200.0, 5.0 * f) for f in range(4, FRAMES)]
    seen = table(TruthBoxes, [row for row in true_rows() if row[1] == "a"])
    got = evaluate_boxes(table(Boxes, early + again), seen, MultiTargetConfig(assigned_target="start")).metrics
    assert (got["position_failures"], got["label_failures"], got["id_switches"], got["fp"]) == (2, 0, 1, 2)
    got = evaluate_boxes(table(Boxes, early + again), seen, MultiTargetConfig(assigned_target="optimal")).metrics
    assert (got["position_failures"], got["label_failures"]) == (2, 4)  # 8 has no target of its own next to 9


def test_frames_are_reported_by_time_or_by_number() -> None:
    tracks, true = table(Boxes, tracked_rows()), truth()
    late = Boxes.of(
        **{c.name: getattr(tracks, c.name) for c in Boxes.columns() if c.name != "t_ns"}, t_ns=tracks.t_ns + 7
    )
    with pytest.raises(InputError, match="tracks: none of their times"):
        evaluate_boxes(late, true)
    assert evaluate_boxes(late, true, by_number=True).metrics == evaluate_boxes(tracks, true).metrics


def test_what_is_compared() -> None:
    """Frames without truth, known to be empty, not asked for; cameras without tracks, not asked for."""
    rows = [(f, "a", 1, 100.0, 5.0 * f) for f in range(4)]
    empty = table(TruthBoxes, [*rows[:2], (2, "a", -1, np.nan, np.nan)])
    empty = TruthBoxes.of(
        **{c.name: getattr(empty, c.name) for c in TruthBoxes.columns() if c.name != "box"},
        box=np.where(empty.frame == 2, -1, 0).astype(np.int32),
    )
    got = evaluate_boxes(table(Boxes, rows), empty).metrics
    assert (got["frames"], got["objects"], got["fp"], got["estimates_other_frames"]) == (3, 2, 1, 1)
    got = evaluate_boxes(table(Boxes, rows), truth(), MultiTargetConfig(frames=(0, 2))).metrics
    assert (got["frames"], got["objects"], got["views_without_tracks"]) == (2, 4, 1)
    made = evaluate_boxes(table(Boxes, rows), truth())
    assert made.notes == ("skipped: b: in the truth, but without any track",)
    assert (made.metrics["frames"], made.metrics["frames_without_tracks"]) == (10, 6)
    got = evaluate_boxes(table(Boxes, tracked_rows()), truth(), MultiTargetConfig(cameras=("b",))).metrics
    assert (got["objects"], got["fr_l"], "fr_p_sensor_b" in got) == (20, 0.0, False)


def test_nothing_was_tracked() -> None:
    got = evaluate_boxes(Boxes.empty(), truth()).metrics
    assert (got["fr_p"], got["fr_l"], got["mota"], got["hota"], got["objects"]) == (1.0, 0.0, 0.0, 0.0, 40)


@pytest.mark.parametrize(
    ("tracks", "words"),
    [
        ([(0, "c", 1, 0.0, 0.0)], r"tracks: their cameras \(c\) are none of the truth \(a, b\)"),
        ([(0, "a", 1, 0.0, 0.0), (0, "a", 1, 5.0, 0.0)], "tracks: camera a, frame 0: target 1 twice"),
        ([(3, "b", -1, 0.0, 0.0)], "tracks: camera b, frame 3: a box without an identity"),
        ([(70, "b", 1, 0.0, 0.0)], "tracks: none of their times"),
    ],
)
def test_tracks_that_cannot_be_compared(tracks: list[Row], words: str) -> None:
    with pytest.raises(InputError, match=words):
        evaluate_boxes(table(Boxes, tracks), truth())


@pytest.mark.parametrize(
    ("config", "words"),
    [
        (MultiTargetConfig(cameras=("z",)), "truth: no rows of camera z; choose with --camera: a, b"),
        (MultiTargetConfig(frames=(50, 60)), "truth: no row in frames 50:60 of --frames; its frames are 0 to 9"),
    ],
)
def test_nothing_that_was_asked_for(config: MultiTargetConfig, words: str) -> None:
    with pytest.raises(InputError, match=words):
        evaluate_boxes(table(Boxes, tracked_rows()), truth(), config)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("distance_gate", 0.0),
        ("distance_gate_px", -1.0),
        ("match_iou", 0.0),
        ("gospa_p", 0.5),
        ("gospa_alpha", 2.5),
        ("assigned_target", "any"),
        ("clear_rule", "none"),
        ("match_distance", math.inf),
        ("track_gap_s", -1.0),
        ("frames", (5, 5)),
    ],
)
def test_options_that_cannot_be(name: str, value: Any) -> None:
    with pytest.raises(InputError, match=f"many targets: {name} is"):
        MultiTargetConfig(**{name: value})


def test_the_box_of_an_ellipse_holds_it() -> None:
    rng = np.random.default_rng(0)
    n = 50
    a, b, rho = rng.uniform(2, 40, n), rng.uniform(2, 40, n), rng.uniform(-np.pi / 2, np.pi / 2, n)
    zero, none = np.zeros(n), np.full(n, "")
    tracks = ViewTracks.of(
        t_ns=np.arange(n),
        sensor=np.full(n, "a"),
        frame=np.arange(n),
        target_id=np.zeros(n, np.int32),
        x_px=rng.uniform(0, 99, n),
        y_px=rng.uniform(0, 99, n),
        a_px=a,
        b_px=b,
        rho=rho,
        cov_xx_px=zero,
        cov_xy_px=zero,
        cov_yy_px=zero,
        similarity=zero,
        ess=zero,
        likelihood_mode=none,
        counterpart=none,
        neighbours=none,
        assisting_views=none,
        lifecycle=none,
    )
    angle = np.linspace(0, 2 * np.pi, 20_001)[:, None]
    x = tracks.x_px + a * np.cos(angle) * np.cos(rho) - b * np.sin(angle) * np.sin(rho)
    y = tracks.y_px + a * np.cos(angle) * np.sin(rho) + b * np.sin(angle) * np.cos(rho)
    boxes = boxes_of_ellipses(tracks)
    for low, size, points in ((boxes.left_px, boxes.width_px, x), (boxes.top_px, boxes.height_px, y)):
        np.testing.assert_allclose(low, points.min(axis=0), atol=1e-5)
        np.testing.assert_allclose(low + size, points.max(axis=0), atol=1e-5)
