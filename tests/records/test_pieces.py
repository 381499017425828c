"""Tables in pieces: no time is split, every row comes once, and has its neighbours about it."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pytest

from occlog.errors import InputError
from occlog.records.tables import LAST, TableBuffer, Tracks, in_step, whole_times, windows


def at(t_ns: np.ndarray) -> Tracks:
    n = len(t_ns)
    zero = {name: np.zeros(n) for name in ("y", "vx", "vy", "cov_xx", "cov_xy", "cov_yy")}
    return Tracks.of(t_ns=t_ns, target_id=np.zeros(n, np.int32), x=np.arange(n) * 1.0, **zero)


def chunks(table: Tracks, rows: int) -> Iterator[Tracks]:
    yield Tracks.empty()
    for start in range(0, len(table), rows):
        yield table.take(slice(start, start + rows))


@pytest.mark.parametrize("rows", [1, 2, 5, 100])
def test_no_time_is_split(rows: int) -> None:
    table = at(np.repeat(np.arange(10), [1, 3, 1, 1, 7, 2, 1, 1, 4, 2]))
    pieces = list(whole_times(chunks(table, rows)))
    np.testing.assert_array_equal(np.concatenate([p.x for p in pieces]), table.x)
    assert all(a.t_ns[-1] < b.t_ns[0] for a, b in pairwise(pieces))
    with pytest.raises(InputError, match="t_ns goes back from 5 to 4"):
        list(whole_times([at(np.array([5])), at(np.array([4]))]))


@pytest.mark.parametrize("rows", [1, 3, 1000])
@pytest.mark.parametrize("margin", [0, 4, 50])
@pytest.mark.parametrize("shift", [0, 300, 1 - 2**62])
def test_windows_hold_every_row_once_with_its_neighbours(rows: int, margin: int, shift: int) -> None:
    random = np.random.default_rng(rows * 100 + margin)
    a, b = (at(np.sort(random.integers(0, 200, n)) + more) for n, more in ((60, 0), (35, shift)))
    found = list(windows(chunks(a, rows), chunks(b, rows + 1), (Tracks, Tracks), margin))
    for side, table in (("a", a), ("b", b)):
        np.testing.assert_array_equal(np.concatenate([getattr(w, side).x for w in found]), table.x)
    for w in found:
        own = np.concatenate([w.a.t_ns, w.b.t_ns])
        for table, about in ((a, w.about_a), (b, w.about_b)):
            near = (table.t_ns >= own.min() - margin) & (table.t_ns <= own.max() + margin)
            assert np.isin(table.x[near], about.x).all()
    if rows == 1 and margin == 0 and shift == 0:
        assert len(found) > 20


def test_windows_refuse_chunks_that_go_back() -> None:
    back = [at(np.array([5, 6])), at(np.array([4]))]
    with pytest.raises(InputError, match=r"tracks: t_ns goes back from 6 to 4"):
        list(windows(back, [at(np.array([9]))], (Tracks, Tracks), 0))


@pytest.mark.parametrize("rows", [1, 4, 1000])
def test_three_tables_go_side_by_side_with_margins_of_their_own(rows: int) -> None:
    random, margins = np.random.default_rng(rows), (0, 5, 40)
    tables = [at(np.sort(random.integers(0, 300, n))) for n in (70, 20, 200)]
    sides = [TableBuffer(chunks(table, rows + k), Tracks) for k, table in enumerate(tables)]
    found: list[list[Tracks]] = [[], [], []]
    ends = []
    for limits in in_step(sides, margins):
        ends.append(limits.end)
        for k, (side, table, margin) in enumerate(zip(sides, tables, margins, strict=True)):
            found[k].append(limits.of(side))
            near = (table.t_ns >= limits.begin - margin) & (table.t_ns < min(limits.end + margin, LAST))
            np.testing.assert_array_equal(limits.about(side, margin).x, table.x[near])
    assert ends == sorted(ends)
    assert ends[-1] == LAST
    for parts, table in zip(found, tables, strict=True):
        np.testing.assert_array_equal(np.concatenate([part.x for part in parts]), table.x)
