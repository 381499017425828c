"""Life cycle of a filter: when a scan initiates, updates or restarts it."""

from __future__ import annotations

import math

import pytest

from occlog.array_types import NS
from occlog.filtering.lifecycle import advance, elapsed, is_lost, track_loss_count


def run(dt: float, *, known: bool = True, explained: bool = True, lost: bool = False) -> tuple[str, int]:
    """What a filter with a gap of 2 s does after dt."""

    def loss(posterior: str) -> tuple[int, bool]:
        return (0, True) if lost and posterior.startswith("updated") else (7, False)

    return advance(
        dt,
        2.0,
        known=known,
        initiate=lambda reason: f"initiated {reason}",
        update=lambda dt: f"updated {dt}" if explained else None,
        loss=loss,
    )


@pytest.mark.parametrize(
    ("dt", "known", "explained", "lost", "expected"),
    [
        (0.0, False, True, False, ("initiated ", 7)),
        (0.5, True, True, False, ("updated 0.5", 7)),
        (2.0, True, True, False, ("updated 2.0", 7)),
        (math.nextafter(2.0, 3.0), True, True, False, ("initiated gap", 7)),
        (0.5, True, False, False, ("initiated restart", 7)),
        (0.5, True, True, True, ("initiated restart", 0)),
    ],
)
def test_a_scan_initiates_or_updates(
    dt: float, known: bool, explained: bool, lost: bool, expected: tuple[str, int]
) -> None:
    assert run(dt, known=known, explained=explained, lost=lost) == expected


def test_time_goes_forward_alone() -> None:
    assert elapsed(None, 5 * NS) == 0.0
    assert elapsed(3 * NS, 5 * NS) == 2.0
    assert elapsed(5 * NS, 5 * NS) == 0.0
    with pytest.raises(ValueError, match="earlier"):
        elapsed(5 * NS, 5 * NS - 1)


@pytest.mark.parametrize(
    ("before", "against", "reports", "after"),
    [(0, 1, 1, 1), (0, 2, 2, 2), (0, 3, 3, 2), (3, 0, 1, 2), (3, 0, 9, 1), (1, 0, 2, 0), (4, 1, 2, 4), (4, 0, 0, 4)],
)
def test_a_scan_changes_the_track_loss_counter_by_two_at_most(
    before: int, against: int, reports: int, after: int
) -> None:
    assert track_loss_count(before, against, reports) == after


def test_a_limit_of_zero_is_never_reached() -> None:
    assert not is_lost(100, 0)
    assert not is_lost(5, 6)
    assert is_lost(6, 6)
