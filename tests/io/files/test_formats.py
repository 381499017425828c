"""Text tables by their declared columns: values, defaults, limits, and one line for what is none of them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from occlog.errors import InputError
from occlog.io.files.texts.formats import IDENTITY, LENGTH, TEXT, WHOLE, FormatColumn, TextFormat, read_format

BUOYS = TextFormat(
    "a table of buoys",
    {
        "name": FormatColumn(("name", "buoy"), TEXT),
        "x": FormatColumn(("x", "x_m"), LENGTH),
        "depth": FormatColumn(("depth_m",), least=0.0, most=11_000.0, unit="m", default=math.nan),
        "reach": FormatColumn(("reach",), above=0.0, default=math.inf),
        "group": FormatColumn(("group",), IDENTITY, least=-1, default=-1),
        "count": FormatColumn(("count",), WHOLE, default=7),
        "state": FormatColumn(("state",), TEXT, choices=("on", "off"), default="on"),
    },
    times=True,
    ignored=("colour",),
)


def read(folder: Path, text: str, **options: bool) -> dict[str, list[object]]:
    path = folder / "buoys.csv"
    path.write_text(text)
    (part,) = read_format(path, BUOYS, **options)
    return {"t_ns": part.times().tolist()} | {name: part[name].tolist() for name in BUOYS.columns}


def test_values_come_under_the_names_of_the_program(tmp_path: Path) -> None:
    found = read(tmp_path, "time;Buoy;x_m;depth_m;reach;group;count;state;colour\n1.5;A;2;3;4;5;6;off;red\n")
    assert found == {
        "t_ns": [1_500_000_000], "name": ["A"], "x": [2.0], "depth": [3.0], "reach": [4.0], "group": [5],
        "count": [6], "state": ["off"],
    }  # fmt: skip


def test_what_is_left_out_has_its_default(tmp_path: Path) -> None:
    found = read(tmp_path, "t_ns,name,x\n5,A,1\n")
    assert np.isnan(found.pop("depth")).all()
    assert found == {
        "t_ns": [5], "name": ["A"], "x": [1.0], "reach": [math.inf], "group": [-1], "count": [7], "state": ["on"],
    }  # fmt: skip
    assert read(tmp_path, "t_ns,name,x,reach,count\n5,A,1,,\n6,B,2,3,4\n")["reach"] == [math.inf, 3.0]


@pytest.mark.parametrize(
    ("column", "good", "bad", "limit"),
    [
        ("depth_m", "0", "-1e-9", "must be 0 to 11000 m, or empty"),
        ("depth_m", "11000", "11000.001", "must be 0 to 11000 m, or empty"),
        ("reach", "1e-9", "0", "must be above 0, or empty"),
        ("group", "-1", "-2", "must be -1 to 2147483647"),
        ("group", "2147483647", "2147483648", "must be -1 to 2147483647"),
        ("count", "3.0", "3.5", "a whole number was expected"),
        ("state", "off", "idle", "must be on or off"),
    ],
)
def test_a_value_at_its_limit_is_read_and_one_beyond_is_named(
    tmp_path: Path, column: str, good: str, bad: str, limit: str
) -> None:
    read(tmp_path, f"t_ns,name,x,{column}\n5,A,1,{good}\n")
    with pytest.raises(InputError, match=rf"buoys\.csv: line 3: .*{limit}") as caught:
        read(tmp_path, f"t_ns,name,x,{column}\n5,A,1,{good}\n6,B,1,{bad}\n")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("t_ns,x\n5,1\n", "has no column name; add it"),
        ("t_ns,group\n5,1\n", "has no column name and x; add it"),
        ("name,x\nA,1\n", "has no column of times"),
        ("t_ns,name,x,mood\n5,A,1,2\n", "unknown column 'mood'"),
        ("t_ns,name,x\n5, ,1\n", "line 2: name is empty"),
        ("t_ns,name,x\n5,A,\n", "line 2: x is missing"),
        ("t_ns,name,x\n5,A,1e3\n", "line 2: x is '1e3': known to 1000 only"),
    ],
)
def test_a_table_that_is_none_is_one_line(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        read(tmp_path, text)


def test_other_columns_are_left_out_where_that_is_allowed(tmp_path: Path) -> None:
    assert read(tmp_path, "t_ns,name,x,mood\n5,A,1,2\n", ignore_extra=True)["x"] == [1.0]
