"""Errors name true targets: of which track they are, and what a page then calls them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from made_up import run

from occlog.records.tables import Errors, Tracks
from occlog.report.content.accuracy import matching_tracks
from occlog.report.content.model import ReportInput
from occlog.report.page import build_page

STEP = 10**8


def renamed(names: dict[int, int]) -> ReportInput:
    """A run of targets whose tracks have other names."""
    data = run(steps=60, targets=len(names))
    assert data.tracks is not None
    assert data.errors is not None
    own = np.array([names[target] for target in data.tracks.target_id.tolist()], dtype=np.int32)
    # Errors are those of the estimates of the same rows
    errors = replace(data.errors, x=data.tracks.x.copy(), y=data.tracks.y.copy())
    assert (errors.t_ns == data.tracks.t_ns).all()
    return replace(data, tracks=replace(data.tracks, target_id=own), errors=errors, diagnostics=None, bearings=None)


def tables(*rows: tuple[int, int, int, float]) -> tuple[Errors, Tracks]:
    """Errors and tracks of rows (step, true target, track, x)."""
    step, target, track, x = (np.array(column) for column in zip(*rows, strict=True))
    zero = np.zeros(len(step))
    errors = Errors.of(
        t_ns=step * STEP, target_id=target, x=x, y=zero, truth_x=x, truth_y=zero, error_x=zero, error_y=zero,
        error=zero, nees=zero,
    )  # fmt: skip
    tracks = Tracks.of(
        t_ns=step * STEP, target_id=track, x=x, y=zero, vx=zero, vy=zero, cov_xx=zero, cov_xy=zero, cov_yy=zero
    )
    return errors, tracks


def test_the_track_is_the_one_that_was_there() -> None:
    errors, tracks = tables((0, 1, 7, 0.0), (0, 2, 8, 5.0), (1, 1, 7, 1.0), (1, 2, 8, 6.0))
    assert matching_tracks(errors, tracks) == {1: 7, 2: 8}


def test_two_tracks_at_one_place_are_distinguished_by_other_times() -> None:
    errors, tracks = tables((0, 1, 7, 0.0), (0, 2, 8, 0.0), (1, 1, 7, 1.0), (1, 2, 8, 6.0))
    assert matching_tracks(errors, tracks) == {1: 7, 2: 8}


def test_a_target_of_several_tracks_has_none() -> None:
    errors, tracks = tables((0, 1, 7, 0.0), (1, 1, 8, 1.0))
    assert matching_tracks(errors, tracks) == {1: None}


def test_targets_without_estimates_of_their_errors_are_left_out() -> None:
    errors, _ = tables((0, 1, 1, 0.0), (1, 1, 1, 1.0))
    _, elsewhere = tables((0, 9, 9, 50.0), (1, 9, 9, 51.0))
    _, later = tables((5, 9, 9, 0.0))
    assert matching_tracks(errors, elsewhere) == matching_tracks(errors, later) == {}
    assert matching_tracks(errors.take(slice(0, 0)), later) == {}


def test_an_exchange_of_names_is_no_one_elses_error() -> None:
    data = renamed({0: 1, 1: 2, 2: 0})
    assert data.relabelled
    assert data.followers == {0: 1, 1: 2, 2: 0}
    assert data.targets == (0, 1, 2)
    page = build_page(data)
    for target, track in data.followers.items():
        assert f"Error and bound over time, true target {target} (track {track})" in page
    assert ">true target" in page.split("The largest errors:")[1]
    assert "Identities are the tracker&#39;s own" in page or "Identities are the tracker's own" in page


def test_names_of_the_truth_are_no_targets_of_a_page_of_others() -> None:
    data = renamed({0: 10, 1: 11})
    assert data.targets == (10, 11)
    assert "Error and bound over time, true target 1 (track 11)" in build_page(data)


def test_labels_of_bearings_are_no_names_of_tracks_that_have_their_own() -> None:
    data = replace(renamed({0: 1, 1: 0}), bearings=run(steps=60, targets=2).bearings)
    page = build_page(data)
    assert "What each sensor saw, label 1" in page
    assert "What each sensor saw, target" not in page


def test_the_same_names_are_reported_as_ever() -> None:
    data = renamed({0: 0, 1: 1})
    assert not data.relabelled
    page = build_page(data)
    assert "Error and bound over time, target 1" in page
    assert "true target" not in page
