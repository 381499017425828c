"""Bookkeeping of frames: what is listed, added up and forgiven."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from occlog.errors import InputError
from occlog.io.frames.decode import MAX_SEGMENTS, FrameLedger
from occlog.io.video.container import Container
from occlog.records.losses import Loss

SIZE = (64, 48)


def container(frames: int) -> Container:
    return Container("avi", np.arange(frames), np.zeros(frames, dtype=np.bool_), False, None)


def losses(ledger: FrameLedger) -> list[Loss]:
    found: list[Loss] = []
    ledger.report(found.append)
    return found


def delivered(frames: list[int], total: int, start: int = 0, stop: int | None = None) -> FrameLedger:
    ledger = FrameLedger(Path("v.avi"), container(total), total, SIZE, start, stop)
    for index in frames:
        if ledger.accept(index):
            ledger.fits(index, SIZE)
    return ledger


@pytest.mark.parametrize(("holes", "lines"), [(MAX_SEGMENTS, MAX_SEGMENTS), (MAX_SEGMENTS + 1, MAX_SEGMENTS + 1)])
def test_so_many_lost_stretches_are_listed_and_the_rest_is_added_up(holes: int, lines: int) -> None:
    total = 3 * (holes + 1)
    found = losses(delivered([k for k in range(total) if k % 3 != 1 or k // 3 >= holes], total))
    assert len(found) == lines
    assert found[0] == Loss("v.avi", "frame 1", "could not be decoded", 1)
    assert sum(loss.count for loss in found) == holes
    assert found[-1].place.startswith("1 more sections in frames") == (holes > MAX_SEGMENTS)


@pytest.mark.parametrize(("met", "reported"), [(979, False), (978, True)])
def test_an_estimated_count_may_be_two_percent_and_a_frame_too_high(met: int, reported: bool) -> None:
    ledger = FrameLedger(Path("v.ts"), None, 1000, SIZE, 0, None)
    for index in range(met):
        assert ledger.accept(index)
        ledger.fits(index, SIZE)
    assert [loss.count for loss in losses(ledger)] == ([1000 - met] if reported else [])


def test_a_range_begins_with_its_first_frame_and_ends_before_its_last() -> None:
    ledger = FrameLedger(Path("v.avi"), container(10), 10, SIZE, 3, 6)
    assert [index for index in range(10) if ledger.accept(index)] == [3, 4, 5]


def test_pictures_that_go_back_have_no_place() -> None:
    ledger = delivered([0, 1, 1, 0, 2, -1], 3)
    assert [(loss.place, loss.count) for loss in losses(ledger)] == [("behind the damage", 3)]


def test_without_a_frame_of_the_range_there_is_an_error() -> None:
    with pytest.raises(InputError, match="frames from 10 on are requested, but it has only 10"):
        delivered([], 10, start=10).check_any()
    with pytest.raises(InputError, match="not one of the requested frames"):
        delivered([], 10, start=9).check_any()
    delivered([9], 10, start=9).check_any()
