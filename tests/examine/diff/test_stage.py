from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from occlog.errors import InputError
from occlog.examine.diff.result import DiffResult, Limit, Tolerances
from occlog.examine.diff.stage import diff_tables
from occlog.records.tables import APPEARANCE_BINS, Bearings, Diagnostics, Tracks, Truth, Views


def tracks(n: int = 6, targets: int = 2, **columns: Any) -> Tracks:
    t_ns = np.repeat(np.arange(n, dtype=np.int64) * 100, targets)
    k = len(t_ns)
    rng = np.random.default_rng(5)
    values: dict[str, Any] = {
        "t_ns": t_ns,
        "target_id": np.tile(np.arange(targets), n),
        "x": rng.normal(size=k),
        "y": rng.normal(size=k),
        "vx": np.full(k, np.nan),
        "vy": np.zeros(k),
        "cov_xx": np.ones(k),
        "cov_xy": np.zeros(k),
        "cov_yy": np.ones(k),
    }
    return Tracks.of(**(values | columns))


def bearings(angle: Any, sigma: Any = 0.01, target: int = -1, t_ns: Any = None) -> Bearings:
    angle = np.asarray(angle, dtype=float)
    n, nan = len(angle), np.full(len(angle), np.nan)
    return Bearings.of(
        t_ns=np.arange(n) if t_ns is None else np.asarray(t_ns),
        sensor=np.full(n, "cam"),
        target_id=np.full(n, target),
        seen=np.isfinite(angle),
        bearing=angle,
        sigma=np.where(np.isfinite(angle), sigma, np.nan),
        u_px=nan,
        sigma_px=nan,
        score=nan,
    )


def with_cell(table: Any, column: str, row: int, value: Any) -> Any:
    values = getattr(table, column).copy()
    values[row] = value
    return type(table)(**{c.name: getattr(table, c.name) if c.name != column else values for c in table.columns()})


def diff(a: Any, b: Any, tolerances: Tolerances | None = None) -> DiffResult:
    return diff_tables(type(a), [a], [b], tolerances)


def test_a_table_is_the_same_as_itself_with_its_nan() -> None:
    found = diff(tracks(), tracks())
    assert found.same
    assert (found.count_a, found.count_b, found.matched, found.missing, found.added) == (12, 12, 12, 0, 0)
    assert found.columns == {}


def test_a_value_is_named_with_its_key_difference_and_limit() -> None:
    a = tracks()
    b = with_cell(with_cell(a, "x", 7, a.x[7] + 1e-3), "y", 3, a.y[3] - 0.5)
    found = diff(a, b)
    assert not found.same
    assert list(found.columns) == ["x", "y"]
    assert found.columns["x"].rows == found.columns["y"].rows == 1
    assert found.first is not None
    assert (found.first.kind, found.first.location, found.first.column) == ("value", "tracks", "y")
    assert found.first.key == {"t_ns": 100, "target_id": 1}
    assert (found.first.a, found.first.b) == (a.y[3], b.y[3])
    assert found.first.difference == pytest.approx(0.5)
    assert found.first.limit == pytest.approx(1e-9 * max(abs(a.y[3]), abs(b.y[3])))
    assert found.first.unit == "m"
    assert found.columns["x"].largest.key == {"t_ns": 300, "target_id": 1}


def test_default_tolerance_is_the_last_bits() -> None:
    a = tracks()
    assert diff(a, with_cell(a, "x", 4, a.x[4] * (1 + 5e-10))).same
    assert not diff(a, with_cell(a, "x", 4, a.x[4] * (1 + 5e-9))).same


def test_rows_that_are_missing_or_added() -> None:
    a = tracks()
    shorter = a.take(np.arange(12) != 5)
    found = diff(a, shorter)
    assert (found.missing, found.added, found.matched) == (1, 0, 11)
    assert found.first is not None
    assert (found.first.kind, found.first.key) == ("missing", {"t_ns": 200, "target_id": 1})
    found = diff(shorter, a)
    assert (found.missing, found.added) == (0, 1)
    assert found.first is not None
    assert found.first.kind == "added"
    assert found.as_dict()["first"] == {"kind": "added", "place": "tracks", "key": {"t_ns": 200, "target_id": 1}}


def test_the_first_difference_is_first_in_time_whatever_its_kind() -> None:
    a = tracks()
    late_row_gone = with_cell(a, "x", 2, 9.0).take(np.arange(12) != 8)
    assert diff(a, late_row_gone).first.column == "x"  # type: ignore[union-attr]
    early_row_gone = with_cell(a, "x", 8, 9.0).take(np.arange(12) != 2)
    assert diff(a, early_row_gone).first.kind == "missing"  # type: ignore[union-attr]
    two = with_cell(with_cell(a, "y", 4, 9.0), "x", 4, 9.0)
    assert diff(a, two).first.column == "x"  # type: ignore[union-attr]


def test_empty_tables() -> None:
    assert diff(Tracks.empty(), Tracks.empty()).same
    assert diff_tables(Tracks, [], []).same
    found = diff(tracks(), Tracks.empty())
    assert (found.count_a, found.count_b, found.missing) == (12, 0, 12)


def test_a_whole_turn_is_no_difference() -> None:
    a, b = bearings([-np.pi, 3.0]), bearings([np.nextafter(np.pi, 0), 3.0])
    assert diff(a, b).same
    found = diff(bearings([np.pi - 1e-3]), bearings([-np.pi + 1e-3]))
    assert found.first is not None
    assert found.first.difference == pytest.approx(2e-3)


def test_a_deviation_is_not_an_angle() -> None:
    found = diff(bearings([1.0], sigma=0.01), bearings([1.0], sigma=0.01 + 2 * np.pi))
    assert found.first is not None
    assert found.first.column == "sigma"


def test_nan_on_one_side_differs_and_is_the_largest() -> None:
    a = tracks()
    found = diff(a, with_cell(with_cell(a, "vy", 3, np.nan), "vy", 8, 1e6))
    assert found.columns["vy"].rows == 2
    assert found.first is not None
    assert math.isnan(found.first.b)
    assert math.isnan(found.columns["vy"].largest.difference or 0.0)
    assert not diff(a, with_cell(a, "vx", 0, 0.0)).same


def test_labels_truths_and_whole_numbers_are_exact() -> None:
    n = 3
    same = {
        "t_ns": np.arange(n),
        "target_id": np.zeros(n, int),
        "ess": np.ones(n),
        "log_likelihood": np.ones(n),
        "n_observing": np.full(n, 8),
        "n_available": np.full(n, 8),
        "selected": np.full(n, ""),
        "predicted_mse": np.full(n, np.nan),
        "cameras": np.full(n, "a,b"),
    }
    a = Diagnostics.of(**same, n_detected=np.array([1, 2, 3]), fallback=np.array(["", "sir", ""]))
    b = Diagnostics.of(**same, n_detected=np.array([1, 4, 3]), fallback=np.array(["", "sir", "restart"]))
    wide = Tolerances(Limit(100.0, 1.0), units={"1": Limit(100.0)})
    found = diff(a, b, wide)
    assert {name: c.rows for name, c in found.columns.items()} == {"n_detected": 1, "fallback": 1}
    assert found.columns["n_detected"].largest.difference == 2.0
    assert found.columns["fallback"].largest.b == "restart"
    assert found.columns["fallback"].largest.difference is None
    assert found.columns["fallback"].as_dict()["largest"] == {
        "kind": "value",
        "place": "diagnostics",
        "key": {"t_ns": 2, "target_id": 0},
        "column": "fallback",
        "a": "",
        "b": "restart",
    }
    named = Tolerances(columns={"n_detected": Limit(2.0)})
    assert list(diff(a, b, named).columns) == ["fallback"]


def test_tolerances_by_table_column_unit_and_in_general() -> None:
    a = tracks()
    b = with_cell(with_cell(a, "x", 1, a.x[1] + 0.01), "cov_xx", 1, 1.01)
    assert list(diff(a, b).columns) == ["x", "cov_xx"]
    assert list(diff(a, b, Tolerances(columns={"x": Limit(0.1)})).columns) == ["cov_xx"]
    assert list(diff(a, b, Tolerances(columns={"tracks.x": Limit(0.1)})).columns) == ["cov_xx"]
    assert list(diff(a, b, Tolerances(columns={"errors.x": Limit(0.1)})).columns) == ["x", "cov_xx"]
    assert list(diff(a, b, Tolerances(units={"m^2": Limit(0.1)})).columns) == ["x"]
    assert diff(a, b, Tolerances(Limit(0.1))).same
    strict = Tolerances(Limit(0.1), columns={"x": Limit()})
    assert list(diff(a, b, strict).columns) == ["x"]


def test_rows_with_the_same_key_are_paired_in_order() -> None:
    a = bearings([0.1, 0.2, 0.3, 0.4], t_ns=[0, 0, 0, 5])
    assert diff(a, bearings([0.1, 0.2, 0.3, 0.4], t_ns=[0, 0, 0, 5])).same
    found = diff(a, bearings([0.1, 0.25, 0.3, 0.4], t_ns=[0, 0, 0, 5]))
    assert found.columns["bearing"].rows == 1
    assert found.first is not None
    assert found.first.a == 0.2
    found = diff(a, bearings([0.1, 0.2, 0.4], t_ns=[0, 0, 5]))
    assert (found.missing, found.added, found.columns) == (1, 0, {})


def test_wide_columns_name_the_entry() -> None:
    n, bins = 2, APPEARANCE_BINS
    scalars = {c.name: np.ones(n) for c in Views.columns() if c.kind == "f8"} | dict.fromkeys(
        ("frame", "cluster"), np.arange(n)
    )
    rest = {"t_ns": np.arange(n), "sensor": np.full(n, "a"), "target_id": np.full(n, -1)}
    histogram = np.full((n, bins), np.nan, dtype=np.float32)
    histogram[1] = 1 / bins
    a = Views.of(**scalars, **rest, appearance=histogram)
    assert diff(a, a).same
    other = histogram.copy()
    other[1, 7] += 0.25
    found = diff(a, Views.of(**scalars, **rest, appearance=other))
    assert found.first is not None
    assert found.first.column == "appearance[7]"
    assert found.first.difference == pytest.approx(0.25)
    assert found.columns["appearance"].rows == 1
    last_bit = histogram.copy()
    last_bit[1, 7] = np.nextafter(last_bit[1, 7], np.float32(1))
    assert diff(a, Views.of(**scalars, **rest, appearance=last_bit)).same


def test_times_may_differ_within_a_limit() -> None:
    a = bearings([0.1, 0.2, 0.3], t_ns=[0, 1000, 2000], target=0)
    b = bearings([0.1, 0.2, 0.3], t_ns=[3, 998, 2300], target=0)
    assert diff(a, b).matched == 0
    found = diff(a, b, Tolerances(time_ns=10))
    assert (found.matched, found.missing, found.added) == (2, 1, 1)
    assert found.first is not None
    assert (found.first.kind, found.first.key["t_ns"]) == ("missing", 2000)
    assert diff(a, b, Tolerances(time_ns=300)).same


def test_the_nearest_in_time_wins_and_exact_times_first() -> None:
    a = bearings([0.1, 0.2], t_ns=[100, 106], target=0)
    b = bearings([0.2, 0.3], t_ns=[104, 109], target=0)
    found = diff(a, b, Tolerances(time_ns=10))
    assert found.matched == 2  # 106 with 104, then 100 with 109
    assert {c.rows for c in found.columns.values()} == {1}
    exact = diff(a, bearings([0.1, 0.2, 0.9], t_ns=[100, 106, 107], target=0), Tolerances(time_ns=10))
    assert (exact.matched, exact.added, exact.columns) == (2, 1, {})


def test_duplicate_keys_within_the_time_limit() -> None:
    a = bearings([0.1, 0.2], t_ns=[100, 100])
    b = bearings([0.1, 0.2], t_ns=[103, 103])
    assert diff(a, b, Tolerances(time_ns=5)).same


@pytest.mark.parametrize("time_ns", [0, 150])
@pytest.mark.parametrize("seed", range(5))
def test_chunks_of_any_size_give_the_same_answer(seed: int, time_ns: int) -> None:
    rng = np.random.default_rng(seed)
    a = tracks(80)
    b = a.take(rng.random(len(a)) < 0.9)
    for row in rng.choice(len(b), 5, replace=False):
        b = with_cell(b, "x", int(row), b.x[row] + rng.normal())
    whole = diff(a, b, Tolerances(time_ns=time_ns))

    def chunks(table: Tracks) -> list[Tracks]:
        cuts = np.sort(rng.choice(len(table) + 1, 9))
        return [table.take(slice(int(i), int(j))) for i, j in zip([0, *cuts], [*cuts, len(table)], strict=True)]

    assert diff_tables(Tracks, chunks(a), chunks(b), Tolerances(time_ns=time_ns)) == whole
    assert whole.missing > 0
    assert whole.columns["x"].rows == 5


def test_long_tables_are_compared_piece_by_piece() -> None:
    """Neither side is read to its end before the other: only what covers the same time is held."""
    read = {"a": 0, "b": 0}
    apart = []

    def chunks(name: str, rows: int) -> Any:
        for k in range(0, 12_000, rows):
            read[name] = k
            apart.append(abs(read["a"] - read["b"]))
            t_ns = np.arange(k, k + rows)
            yield tracks(rows, 1, t_ns=t_ns)

    found = diff_tables(Tracks, chunks("a", 1000), chunks("b", 300))
    assert found.count_a == found.count_b == found.matched == 12_000
    assert max(apart) <= 1300


def test_chunks_that_go_back_in_time_are_an_error() -> None:
    a = tracks()
    with pytest.raises(InputError, match="goes back"):
        diff_tables(Tracks, [a.take(slice(6, 12)), a.take(slice(0, 6))], [a])


KEYS = st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 3)), min_size=1, max_size=30, unique=True)


def truth(keys: list[tuple[int, int]], rng: np.random.Generator) -> Truth:
    n = len(keys)
    t_ns, target = np.array(keys).T
    order = np.lexsort([target, t_ns])
    return Truth.of(
        t_ns=t_ns[order],
        target_id=target[order],
        role=np.full(n, "target"),
        x=rng.normal(size=n),
        y=rng.normal(size=n),
        z=np.where(rng.random(n) < 0.3, np.nan, 1.0),
    )


@given(KEYS, st.integers(0, 2**32 - 1))
def test_the_order_of_rows_of_one_time_does_not_matter(keys: list[tuple[int, int]], seed: int) -> None:
    rng = np.random.default_rng(seed)
    a = truth(keys, rng)
    shuffled = rng.permutation(len(a))
    b = a.take(shuffled[np.argsort(a.t_ns[shuffled], kind="stable")])
    assert diff(a, b).same
    assert diff(a, a.take(shuffled[np.lexsort([a.target_id[shuffled], a.t_ns[shuffled]])])).same


@given(KEYS, st.integers(0, 2**32 - 1), st.sampled_from(["x", "y"]), st.floats(1e-6, 1e3), st.booleans(), st.data())
def test_a_changed_cell_is_found_and_named(
    keys: list[tuple[int, int]], seed: int, column: str, limit: float, beyond: bool, data: st.DataObject
) -> None:
    a = truth(keys, np.random.default_rng(seed))
    row = data.draw(st.integers(0, len(a) - 1))
    step = limit * (1.01 if beyond else 0.99)
    b = with_cell(a, column, row, getattr(a, column)[row] + step)
    found = diff(a, b, Tolerances(Limit(limit)))
    if not beyond:
        assert found.same
        return
    assert found.first is not None
    assert (found.first.column, found.first.key) == (
        column,
        {"t_ns": int(a.t_ns[row]), "target_id": int(a.target_id[row])},
    )
    assert found.columns[column].rows == 1
    assert found.first == found.columns[column].largest
    assert found.first.difference == pytest.approx(step, rel=1e-6, abs=1e-12)


@given(KEYS, KEYS, st.integers(0, 100))
def test_rows_add_up_against_sets(left: list[tuple[int, int]], right: list[tuple[int, int]], seed: int) -> None:
    rng = np.random.default_rng(seed)
    found = diff(truth(left, rng), truth(right, rng))
    assert found.matched == len(set(left) & set(right))
    assert found.missing == len(set(left) - set(right))
    assert found.added == len(set(right) - set(left))
    if alone := sorted(set(left) ^ set(right)):
        assert found.first is not None
        assert tuple(found.first.key.values()) <= alone[0]


def test_rows_exactly_as_far_apart_in_time_as_allowed_are_the_same() -> None:
    a, b = bearings([0.1], t_ns=[1000], target=0), bearings([0.1], t_ns=[1010], target=0)
    assert diff(a, b, Tolerances(time_ns=10)).same
    assert not diff(a, b, Tolerances(time_ns=9)).same


def test_numbers_exactly_as_far_apart_as_the_limit_are_the_same() -> None:
    a, b = bearings([0.0], target=0), bearings([0.25], target=0)
    assert diff(a, b, Tolerances(Limit(atol=0.25))).same
    assert not diff(a, b, Tolerances(Limit(atol=np.nextafter(0.25, 0.0)))).same
    assert diff(bearings([0.5], target=0), bearings([1.0], target=0), Tolerances(Limit(rtol=0.5))).same
