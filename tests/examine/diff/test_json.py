from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.examine.diff.content import diff_bytes, diff_json
from occlog.examine.diff.result import Limit, Tolerances
from occlog.examine.diff.run import stage_order
from occlog.examine.diff.stage import diff_schemas

METRICS = {"rmse_m": 0.71, "targets": 2, "nothing": None, "ok": True, "sensors": [{"name": "a", "rate": 10.0}, 3]}


def changed(path: list[Any], value: Any) -> Any:
    out = copy.deepcopy(METRICS)
    place: Any = out
    for step in path[:-1]:
        place = place[step]
    place[path[-1]] = value
    return out


def test_the_same_and_the_last_bits() -> None:
    found = diff_json("metrics.json", METRICS, changed(["rmse_m"], 0.71 * (1 + 1e-10)))
    assert found.same
    assert (found.what, found.count_a, found.matched) == ("values", 7, 7)


@pytest.mark.parametrize(
    ("path", "value", "shown"),
    [
        (["rmse_m"], 0.72, "rmse_m"),
        (["targets"], 3, "targets"),
        (["ok"], False, "ok"),
        (["ok"], 1, "ok"),
        (["nothing"], 0.0, "nothing"),
        (["sensors", 0, "rate"], 10.1, "sensors[0].rate"),
        (["sensors", 0, "name"], "b", "sensors[0].name"),
        (["sensors", 1], "3", "sensors[1]"),
        (["sensors"], {}, "sensors"),
        (["rmse_m"], float("nan"), "rmse_m"),
        (["rmse_m"], float("inf"), "rmse_m"),
    ],
)
def test_a_change_is_named_by_its_path(path: list[Any], value: Any, shown: str) -> None:
    found = diff_json("metrics.json", METRICS, changed(path, value))
    assert found.first is not None
    assert found.first.key == {"path": shown}
    assert found.first.kind == "value"


def test_missing_and_added_entries() -> None:
    fewer = {k: v for k, v in METRICS.items() if k != "ok"}
    found = diff_json("m", METRICS, fewer)
    assert (found.missing, found.added, found.count_a, found.count_b) == (1, 0, 7, 6)
    found = diff_json("m", fewer, METRICS)
    assert found.first is not None
    assert (found.first.kind, found.first.key, found.first.b) == ("added", {"path": "ok"}, True)
    found = diff_json("m", METRICS, changed(["sensors"], METRICS["sensors"][:1]))
    assert found.first is not None
    assert (found.first.kind, found.first.key) == ("missing", {"path": "sensors[1]"})


def test_tolerances_by_key_and_file() -> None:
    other = changed(["rmse_m"], 0.8)
    assert diff_json("metrics.json", METRICS, other, Tolerances(columns={"rmse_m": Limit(0.1)})).same
    assert diff_json("run/metrics.json", METRICS, other, Tolerances(columns={"metrics.rmse_m": Limit(0.1)})).same
    assert diff_json("m", METRICS, other, Tolerances(Limit(0.1))).same
    assert not diff_json("m", METRICS, changed(["targets"], 3), Tolerances(Limit(5.0))).same
    assert diff_json("m", METRICS, changed(["targets"], 3), Tolerances(columns={"targets": Limit(1.0)})).same


def test_whole_numbers_of_any_length_are_exact() -> None:
    assert not diff_json("m", 1_700_000_000_000_000_000, 1_700_000_000_000_000_001).same
    assert not diff_json("m", 10**400, 10**400 + 1).same
    assert diff_json("m", 10**400, 10**400).same
    assert not diff_json("m", 10**400, 1.5).same


def test_provenance_is_left_out_unless_asked_for() -> None:
    a, b = {"_provenance": {"seed": 1}, "x": 1, "_version": 1}, {"_provenance": {"seed": 2}, "x": 1}
    assert diff_json("m", a, b).same
    found = diff_json("m", a, b, provenance=True)
    assert (found.first is not None, found.missing) == (True, 1)


def test_nan_is_nan() -> None:
    assert diff_json("m", [float("nan"), None], [float("nan"), None]).same


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text("abc_", max_size=3), inner, max_size=4),
    max_leaves=20,
)


@given(VALUES)
def test_any_value_is_the_same_as_its_own_copy(value: Any) -> None:
    again = json.loads(json.dumps(value))
    assert diff_json("v", value, again, provenance=True).same
    assert diff_json("v", again, value, provenance=True).same


@given(VALUES, VALUES)
def test_any_two_values_can_be_compared_both_ways(a: Any, b: Any) -> None:
    there, back = diff_json("v", a, b, provenance=True), diff_json("v", b, a, provenance=True)
    assert there.same == back.same
    assert (there.missing, there.added, there.matched) == (back.added, back.missing, back.matched)
    json.dumps(there.as_dict())


def test_bytes_name_the_byte_and_the_line() -> None:
    assert diff_bytes("f", b"abc", b"abc").same
    found = diff_bytes("f", b"a: 1\nb: 2\n", b"a: 1\nb: 3\n")
    assert found.first is not None
    assert found.first.key == {"byte": 8, "line": 2}
    assert (found.first.a, found.first.b) == ("b: 2", "b: 3")
    found = diff_bytes("f", b"a\n", b"a\nb\n")
    assert found.first is not None
    assert (found.first.key, found.first.a, found.first.b) == ({"byte": 2, "line": 2}, None, "b")
    binary = bytes(range(256)) * 40
    found = diff_bytes("f", binary, binary[:9000] + b"\xff" + binary[9001:])
    assert found.first is not None
    assert found.first.key == {"byte": 9000}


def test_schemas() -> None:
    a = {
        "schema": "tracks",
        "version": 1,
        "length_unit": "m",
        "columns": [{"name": "x", "type": "double", "unit": "m"}, {"name": "y", "type": "double", "unit": "m"}],
    }
    assert diff_schemas("t", a, copy.deepcopy(a)) == ()
    b = copy.deepcopy(a)
    b["length_unit"] = "ft"
    b["columns"][0]["unit"] = "rad"
    b["columns"][1] = {"name": "z", "type": "double", "unit": "m"}
    found = diff_schemas("t", a, b)
    assert [(d.column, d.a, d.b) for d in found] == [
        ("length_unit", "m", "ft"),
        ("y", "column", None),
        ("z", None, "column"),
        ("x", "m", "rad"),
    ]
    assert all(d.kind == "schema" for d in found)


def test_another_unit_of_length_is_reported_once() -> None:
    def said(unit: str) -> dict[str, Any]:
        units = {"x": unit, "v": f"{unit}/s", "p": f"{unit}^2", "u": "px"}
        columns = [{"name": name, "type": "double", "unit": u} for name, u in units.items()]
        return {"schema": "t", "version": 1, "length_unit": unit, "columns": columns}

    assert [d.column for d in diff_schemas("t", said("m"), said("ft"))] == ["length_unit"]


def test_outputs_of_earlier_stages_come_first() -> None:
    names = [
        "report.html",
        "zzz.txt",
        "metrics.json",
        "tracks.parquet",
        "diagnostics.parquet",
        "recording.mcap",
        "bearings.parquet",
        "errors.parquet",
        "sub/views.parquet",
        "bound.parquet",
        "aaa.txt",
    ]
    assert stage_order(names) == [
        "recording.mcap",
        "sub/views.parquet",
        "bearings.parquet",
        "tracks.parquet",
        "diagnostics.parquet",
        "errors.parquet",
        "bound.parquet",
        "metrics.json",
        "report.html",
        "aaa.txt",
        "zzz.txt",
    ]


def test_a_key_that_is_there_twice_is_refused(tmp_path: Path) -> None:
    """The last one counted, so that the two were the same."""
    (tmp_path / "a.json").write_text('{"rmse_m": 1, "rmse_m": 2}')
    (tmp_path / "b.json").write_text('{"rmse_m": 2}')
    assert run(["diff", str(tmp_path / "a.json"), str(tmp_path / "b.json")]) == ExitCode.BAD_INPUT
