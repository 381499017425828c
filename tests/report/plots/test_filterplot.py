from __future__ import annotations

import numpy as np
import pytest
from made_up import run

from occlog.records.tables import Diagnostics
from occlog.report.content.accuracy import deviation
from occlog.report.content.model import ReportInput
from occlog.report.drawing import new_figure
from occlog.report.page import build_page
from occlog.report.plots.over_time import draw_filter


def without_particles(data: ReportInput) -> ReportInput:
    diagnostics = data.diagnostics
    assert diagnostics is not None
    columns = {c.name: getattr(diagnostics, c.name) for c in Diagnostics.columns()}
    flags = np.full(len(diagnostics), "", dtype="U16")
    flags[:3] = "unobservable"
    batch = Diagnostics(**(columns | {"ess": np.full(len(diagnostics), np.nan), "fallback": flags}))
    return ReportInput(scene=data.scene, tracks=data.tracks, bearings=data.bearings, diagnostics=batch)


@pytest.fixture
def batch() -> ReportInput:
    return without_particles(run())


def test_a_method_without_particles_shows_how_well_it_knows_the_position(batch: ReportInput) -> None:
    diagnostics, tracks = batch.diagnostics, batch.tracks
    assert diagnostics is not None
    assert tracks is not None
    assert batch.filter_diagnostics is not None
    assert not batch.filter_diagnostics.particles
    figure = new_figure(8.4, 2.7)
    draw_filter(figure, batch, diagnostics)
    axes = figure.axes[0]
    assert axes.get_ylabel() == f"standard deviation [{batch.unit}]"
    drawn = np.concatenate(
        [
            line.get_ydata()
            for line in axes.get_lines()
            if "target" in str(line.get_label()) or "deviation" in str(line.get_label())
        ]
    )
    wanted = np.sqrt(tracks.cov_xx + tracks.cov_yy)
    assert np.nanmax(drawn) == pytest.approx(wanted.max())
    np.testing.assert_allclose(deviation(tracks), wanted)
    assert any("position hardly known (3 ×)" in str(line.get_label()) for line in axes.get_lines())


@pytest.mark.drawn
def test_the_page_of_a_method_without_particles(batch: ReportInput) -> None:
    page = build_page(batch)
    assert "Certainty" in page
    assert "Median standard deviation of the position" in page
    assert "Lowest effective sample size" not in page


def test_a_filter_with_particles_shows_their_number() -> None:
    data = run()
    assert data.filter_diagnostics is not None
    assert data.filter_diagnostics.particles
    assert "Lowest effective sample size" in build_page(data)
