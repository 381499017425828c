"""Messages and bytes that tracking costs, counted by hand."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.records.tables import Diagnostics
from occlog.track.drivers.rows import ORDER_BYTES, REPORT_BYTES, NetworkTraffic


def rows(*given):
    """Diagnostics of (t, target, frames used, frames delivered, cameras selected, selected again)."""
    t, target, looked, offered, selected, again = (list(c) for c in zip(*given, strict=True))
    n = len(given)
    return Diagnostics.of(
        t_ns=np.array(t, dtype=np.int64),
        target_id=np.array(target, dtype=np.int32),
        ess=np.full(n, 10.0),
        log_likelihood=np.zeros(n),
        n_observing=np.array(looked, dtype=np.int32),
        n_detected=np.zeros(n, dtype=np.int32),
        fallback=[""] * n,
        cameras=selected,
        n_available=np.array(offered, dtype=np.int32),
        selected=selected,
        predicted_mse=np.where(again, 1.5, np.nan),
    )


def counted(*parts):
    messages = NetworkTraffic()
    for part in parts:
        messages.add(part)
    return messages


def test_sizes_are_those_of_the_documented_fields():
    assert REPORT_BYTES == 2 + 8 + 4 + 4
    assert ORDER_BYTES == 4


def test_nothing_was_sent():
    assert NetworkTraffic().summary() == {}


def test_without_selection_there_are_reports_only():
    found = counted(rows((0, 0, 3, 3, "", False), (1, 0, 2, 2, "", False)))
    assert (found.reports, found.bytes, found.summary()) == (5, 90, {})


def test_only_cameras_that_are_switched_get_an_order():
    found = counted(
        rows(
            (0, 0, 2, 5, "a,b", True),  # a and b on: 2
            (1, 0, 2, 5, "a,b", False),
            (2, 0, 2, 5, "a,b", True),  # the same again: 0
            (3, 0, 2, 5, "b,c", True),  # a off, c on: 2
            (4, 0, 3, 5, "d,e,f", True),  # b and c off, d, e and f on: 5
        )
    )
    assert (found.reports, found.offered, found.orders, found.selections) == (11, 25, 9, 4)
    assert found.summary() == {
        "messages": 20,
        "bytes": 11 * 18 + 9 * 4,
        "selections": 4,
        "bytes_all_cameras": 25 * 18,
        "share_saved": pytest.approx(1 - 234 / 450),
    }


def test_every_target_switches_its_own_cameras():
    found = counted(rows((0, 0, 1, 4, "a", True), (0, 7, 1, 4, "b", True), (1, 0, 1, 4, "a", True)))
    assert (found.orders, found.selections, found.reports) == (2, 3, 3)


def test_where_the_rows_are_cut_does_not_matter():
    table = rows(
        (0, 0, 1, 4, "a", True),
        (0, 7, 2, 4, "b,c", True),
        (1, 0, 1, 4, "c", True),
        (1, 7, 2, 4, "b,c", False),
        (2, 0, 1, 4, "c", False),
        (2, 7, 2, 4, "a,b", True),
    )
    want = counted(table).summary()
    for cut in range(1, len(table)):
        assert counted(table.take(slice(0, cut)), table.take(slice(cut, None))).summary() == want


def test_a_selection_of_no_camera_orders_none():
    """`all` of no cameras, where microphone arrays alone are used."""
    found = counted(rows((0, 0, 1, 1, "", True), (1, 0, 1, 1, "", True)))
    assert found.summary() == {
        "messages": 2,
        "bytes": 36,
        "selections": 2,
        "bytes_all_cameras": 36,
        "share_saved": 0.0,
    }


def test_selecting_all_costs_the_orders():
    """With orders more is sent than without a selection; that is stated, not hidden."""
    found = counted(rows((0, 0, 2, 2, "a,b", True)))
    assert found.summary()["share_saved"] == pytest.approx(-8 / 36)


def test_no_frame_at_all_saves_nothing():
    assert counted(rows((0, 0, 0, 0, "a", True))).summary()["share_saved"] == 0.0
