"""Paths on the floor plan: true ones of everybody, ellipses of many."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_up import run
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from occlog.records.tables import PeopleTracks, Tracks
from occlog.report.content.model import ReportInput
from occlog.report.drawing import COLOURS, house_style
from occlog.report.plots.floorplan import ELLIPSES, ELLIPSES_OF_ALL, draw_floorplan


def drawn(data: ReportInput) -> tuple[int, int]:
    """How many true paths and ellipses there are."""
    figure = Figure()
    with house_style():
        draw_floorplan(figure, data)
    (axes,) = figure.axes
    true = [line for line in axes.lines if line.get_linestyle() == "--" and line.get_color() == COLOURS["ink"]]
    return len(true), sum(isinstance(patch, Ellipse) for patch in axes.patches)


def of_everybody(targets: int, first: int) -> ReportInput:
    """Tracks of everybody, whose names begin at `first`."""
    data = run(steps=60, targets=targets)
    assert data.tracks is not None
    columns = {c.name: getattr(data.tracks, c.name) for c in Tracks.columns()}
    n = len(data.tracks)
    columns |= {"target_id": columns["target_id"] + np.int32(first)}
    tracks = PeopleTracks.of(
        **columns, existence_probability=np.ones(n), seen_by=np.full(n, ""), quality_flags=np.full(n, "")
    )
    return replace(data, tracks=tracks, errors=None, diagnostics=None, bearings=None)


@pytest.mark.parametrize("first", [0, 2, 100])
def test_everybody_has_a_true_path_whatever_tracks_are_called(first: int) -> None:
    assert drawn(of_everybody(4, first))[0] == 4


def test_of_tracks_with_the_names_of_the_truth_those_that_are_tracked_have_one() -> None:
    data = run(steps=60, targets=3)
    assert data.tracks is not None
    assert drawn(replace(data, tracks=data.tracks.take(data.tracks.target_id == 1), errors=None))[0] == 1


@pytest.mark.parametrize("targets", [1, 20, 41])
def test_many_targets_have_fewer_ellipses_each(targets: int) -> None:
    ellipses = drawn(of_everybody(targets, 0))[1]
    assert ellipses == targets * min(ELLIPSES, ELLIPSES_OF_ALL // targets)
