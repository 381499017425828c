"""The report's account of selected cameras."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.records.tables import Diagnostics, Errors, Tracks
from occlog.report.content.model import ReportInput
from occlog.report.page import build_page
from occlog.report.plots.over_time import cameras_of


def diagnostics(mse, selected):
    n = len(mse)
    ones = np.ones(n, dtype=np.int32)
    return Diagnostics(
        np.arange(n, dtype=np.int64) * 10**9,
        np.zeros(n, dtype=np.int32),
        np.ones(n),
        np.ones(n),
        ones,
        ones,
        np.array([""] * n),
        np.array(selected),
        ones,
        np.array(selected),
        np.array(mse),
    )


def tracks(n):
    zero, one = np.zeros(n), np.ones(n)
    t = np.arange(n, dtype=np.int64) * 10**9
    return Tracks.of(
        t_ns=t,
        target_id=np.zeros(n, dtype=np.int32),
        x=zero,
        y=zero,
        vx=zero,
        vy=zero,
        cov_xx=2.0 * one,
        cov_xy=zero,
        cov_yy=2.0 * one,
    )


def selections(table, errors=None):
    return ReportInput(tracks=tracks(5), diagnostics=table, errors=errors).selections


MADE = diagnostics([4.0, np.nan, np.nan, 16.0, np.nan], ["a,b", "a,b", "a,b", "b,c", "b,c"])


def test_selections_last_until_the_next_one():
    found = selections(MADE)
    assert list(found) == [0]
    assert (found[0].times // 10**9).tolist() == [0, 3, 4]
    assert found[0].chosen == ({"a", "b"}, {"b", "c"})
    assert found[0].expected == pytest.approx(np.sqrt((4.0 + 16.0) / 2))
    assert selections(diagnostics([np.nan], [""])) == {}
    assert ReportInput(tracks=tracks(5)).selections == {}


def test_what_was_expected_is_compared_with_what_came_out_at_the_same_times():
    t = MADE.t_ns
    zero = np.zeros(5)
    error = np.array([1.0, 50.0, 50.0, 7.0, 50.0])
    errors = Errors(t, np.zeros(5, dtype=np.int32), zero, zero, zero, zero, error, zero, error, zero)
    both, spread = selections(MADE, errors)[0], selections(MADE)[0]
    assert both.expected == pytest.approx(np.sqrt(10.0))
    assert (both.found, both.what) == (5.0, "error")
    assert (spread.found, spread.what) == (2.0, "stated spread")
    assert np.isnan(ReportInput(tracks=tracks(0), diagnostics=MADE).selections[0].found)


@pytest.mark.drawn
def test_the_page_shows_selected_cameras():
    data = ReportInput(tracks=tracks(5), diagnostics=MADE)
    assert cameras_of(data, data.selections[0]) == ("a", "b", "c")
    assert data.selections[0].shares == {"a": 0.75, "b": 1.0, "c": 0.25}
    page = build_page(data)
    assert "Selected cameras" in page
    assert "2 selections. Expected of them: 3.16" in page
    assert "Selected cameras" not in build_page(ReportInput(tracks=tracks(1), diagnostics=diagnostics([np.nan], [""])))
