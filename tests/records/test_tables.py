"""Tables validate themselves and say what is wrong."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.errors import InputError
from occlog.records.columns import MAX_NS
from occlog.records.tables import TABLES, Bearings, Boxes, Cooperation, Tracks, Truth


def bearings(**changes: object) -> Bearings:
    values: dict[str, object] = {
        "t_ns": [0, 1],
        "sensor": ["a", "b"],
        "target_id": [0, 0],
        "seen": [True, False],
        "bearing": [0.1, np.nan],
        "sigma": [0.01, np.nan],
        "u_px": [3.0, np.nan],
        "sigma_px": [1.0, np.nan],
        "score": [0.9, np.nan],
    }
    return Bearings.of(**{**values, **changes})


def test_other_columns_are_cast_and_rows_with_nan_are_the_same() -> None:
    table = bearings()
    other = table.with_columns(target_id=[5, 6], u_px=[4, np.nan])
    assert (other.target_id.tolist(), other.target_id.dtype, other.u_px.dtype) == ([5, 6], np.int32, np.float64)
    assert other.sensor.tolist() == ["a", "b"]
    assert table.same_rows(bearings())
    assert not table.same_rows(other)
    assert not table.same_rows(table.take(slice(0, 1)))


@pytest.mark.parametrize("table", TABLES.values())
def test_every_column_has_a_unit_and_a_meaning(table: type) -> None:
    for c in table.columns():
        assert c.unit
        assert len(c.doc) > 5
    assert set(table.KEY) <= {c.name for c in table.columns()}
    assert table.columns()[0].name == "t_ns"
    assert len(table.empty()) == 0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"t_ns": [1, 0]}, "t_ns goes back at row 1"),
        ({"bearing": [np.nan, np.nan]}, "row 0: seen is True but bearing is nan"),
        ({"bearing": [4.0, np.nan]}, "must be in"),
        ({"bearing": [np.inf, np.nan]}, "must not be infinite"),
        ({"sigma": [0.0, np.nan]}, "sigma 0 rad at least"),
        ({"sigma_px": [1e-12, np.nan]}, "sigma_px 1e-12 px must be at least 1e-09"),
        ({"sigma_px": [1e300, np.nan]}, r"Bearings.sigma_px: row 0: 1e\+300 px must be within 1e\+15 px"),
        ({"sensor": ["a"]}, "has 1 rows, but the first column 2"),
        ({"target_id": [0.5, 0]}, "target_id"),
        ({"target_id": [0, 2**31]}, "target_id: row 1: 2147483648 must be -2147483648 to 2147483647"),
        ({"target_id": [-(2**31) - 1, 0]}, "target_id: row 0: -2147483649 must be"),
        ({"t_ns": [0, MAX_NS + 1]}, f"t_ns: row 1: its time of {MAX_NS + 1} ns is out of range"),
        ({"t_ns": [-MAX_NS - 1, 0]}, "t_ns: row 0: its time of"),
        ({"t_ns": np.array([2**63, 1], np.uint64)}, f"t_ns: row 0: {2**63} must be"),
    ],
)
def test_contradictions_are_errors(changes: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        bearings(**changes)


def test_whole_numbers_up_to_the_limits_of_their_type_stay_what_they_are() -> None:
    ids = [2**31 - 1, 2**31 - 2]
    assert bearings(target_id=np.array(ids)).target_id.tolist() == ids
    with pytest.raises(InputError, match=f"target_id {-(2**31)} must be at least -1"):
        bearings(target_id=np.array([-(2**31), 0]))
    times = np.array([MAX_NS - 1, MAX_NS], np.uint64)
    assert bearings(t_ns=times).t_ns.tolist() == times.tolist()
    assert bearings(t_ns=[-MAX_NS, MAX_NS]).t_ns.tolist() == [-MAX_NS, MAX_NS]


def test_nan_only_where_it_is_declared() -> None:
    with pytest.raises(InputError, match=r"Truth.x: row 0"):
        Truth.of(t_ns=[0], target_id=[0], role=["target"], x=[np.nan], y=[0.0], z=[np.nan])


def test_wrong_dtype_is_refused() -> None:
    values = {c.name: getattr(bearings(), c.name) for c in Bearings.columns()}
    values["sensor"] = np.array([1, 2])
    with pytest.raises(InputError, match=r"Bearings.sensor: expected U"):
        Bearings(**values)


def test_sort_is_by_key_and_stable() -> None:
    table = bearings(t_ns=[5, 5], sensor=["b", "a"], seen=[True, True], bearing=[0.1, 0.2], sigma=[1.0, 1.0])
    assert table.sorted().sensor.tolist() == ["a", "b"]


def test_concat_keeps_rows_and_long_names() -> None:
    table = Bearings.concat([bearings(), Bearings.empty(), bearings(t_ns=[1, 2], sensor=["a-long-name", "b"])])
    assert table.sensor.tolist() == ["a", "b", "a-long-name", "b"]
    assert len(Bearings.concat([])) == 0


def test_covariances_must_be_positive() -> None:
    good = {"t_ns": [0], "target_id": [0], "x": [0.0], "y": [0.0], "vx": [np.nan], "vy": [np.nan]}
    assert len(Tracks.of(**good, cov_xx=[1.0], cov_xy=[1.0], cov_yy=[1.0])) == 1
    with pytest.raises(InputError, match="not positive semi-definite"):
        Tracks.of(**good, cov_xx=[1.0], cov_xy=[1.1], cov_yy=[1.0])


HEIGHTS = ("z", "vz", "cov_xz", "cov_yz", "cov_zz")
COVARIANCES = ("cov_x_vx", "cov_x_vy", "cov_y_vx", "cov_y_vy", "cov_vx_vx", "cov_vx_vy", "cov_vy_vy")


def test_optional_columns_are_nan_where_they_are_left_out() -> None:
    assert tuple(c.name for c in Tracks.columns() if c.optional) == (*COVARIANCES, *HEIGHTS)
    have = {"t_ns": [0, 1], "target_id": [0, 0], "x": [0.0, 1.0], "y": [0.0, 2.0], "vx": [0.0, 0.0], "vy": [0.0, 0.0]}
    have |= {"cov_xx": [1.0, 1.0], "cov_xy": [0.0, 0.0], "cov_yy": [1.0, 1.0]}
    table = Tracks.of(**have, cov_x_vx=[0.1, 0.2])
    assert table.cov_x_vx.tolist() == [0.1, 0.2]
    for name in (*COVARIANCES[1:], *HEIGHTS):
        values = getattr(table, name)
        assert values.dtype == np.float64
        assert np.isnan(values).tolist() == [True, True]
    both = Tracks.concat([table, table.take(slice(1, 2))])
    assert both.cov_x_vx.tolist() == [0.1, 0.2, 0.2]
    assert np.isnan(both.cov_vy_vy).all()
    assert not len(Tracks.empty().cov_x_vx)
    assert not len(Tracks.of(**{name: [] for name in have}).cov_vx_vy)


def test_optional_texts_are_empty_where_they_are_left_out() -> None:
    table = bearings()
    assert table.cause.tolist() == [""] * len(table)
    assert Bearings.empty().cause.dtype.kind == "U"


@pytest.mark.parametrize(("elevation", "sigma"), [(0.1, np.nan), (np.nan, 0.1), (1.6, 0.1), (0.1, 0.0)])
def test_elevations_are_angles_with_a_deviation(elevation: float, sigma: float) -> None:
    assert bearings(elevation=[0.2, np.nan], sigma_elevation=[0.1, np.nan]).elevation[0] == 0.2
    with pytest.raises(InputError, match="row 0: elevation"):
        bearings(elevation=[elevation, np.nan], sigma_elevation=[sigma, np.nan])
    with pytest.raises(InputError, match="row 1: elevation"):  # not seen
        bearings(elevation=[0.2, 0.2], sigma_elevation=[0.1, 0.1])


def test_who_answers_says_where() -> None:
    row = {"t_ns": [0], "target_id": [1], "cause": ["spread"], "cameras": ["a,b"], "frames": [2]}
    nowhere = {key: [np.nan] for key in ("x", "y", "cov_xx", "cov_xy", "cov_yy")}
    assert len(Cooperation.of(**row, answered=[False], **nowhere)) == 1
    with pytest.raises(InputError, match="answered is True but x is nan"):
        Cooperation.of(**row, answered=[True], **nowhere)


@pytest.mark.parametrize(
    ("change", "message"),
    [({"cov_x_vx": [0.1]}, "has 1 rows, but the first column 2"), ({"cov_vx_vx": [1.0, np.inf]}, "row 1")],
)
def test_optional_columns_are_checked_like_others(change: dict[str, object], message: str) -> None:
    have = {c.name: [0, 0] if c.kind[0] == "i" else [0.0, 0.0] for c in Tracks.columns() if not c.optional}
    with pytest.raises(InputError, match=message):
        Tracks.of(**have, **change)


def test_columns_that_are_not_optional_must_be_given() -> None:
    with pytest.raises(KeyError, match="vx"):
        Tracks.of(t_ns=[0], target_id=[0], x=[0.0], y=[0.0], cov_xx=[1.0], cov_xy=[0.0], cov_yy=[1.0])


def test_boxes_of_no_size_are_refused_but_empty_frames_are_not() -> None:
    values = {"t_ns": [0], "sensor": ["a"], "frame": [0], "target_id": [-1], "confidence": [np.nan]}
    nothing = {k: [np.nan] for k in ("left_px", "top_px", "width_px", "height_px")}
    assert len(Boxes.of(**values, box=[-1], **nothing)) == 1
    with pytest.raises(InputError, match="must be above 0"):
        Boxes.of(**values, box=[0], **{**nothing, "width_px": [0.0], "height_px": [3.0]})
