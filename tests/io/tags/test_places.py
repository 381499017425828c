"""Tables of readers: places, ranges, powers, and every way in which a table can be wrong."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from occlog.errors import InputError
from occlog.io.formats.tags import read_readers


def table(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "readers.csv"
    path.write_text(text)
    return path


def test_places_ranges_and_powers_are_read(tmp_path: Path) -> None:
    a, b = read_readers(table(tmp_path, "reader,x,y,z,range,power\nA,1,2,2.3,4,-59\nB,3,4,,,\n"))
    assert (a.name, a.position.tolist(), a.range, a.power) == ("A", [1.0, 2.0, 2.3], 4.0, -59.0)
    assert (b.name, b.position.tolist(), b.range, b.power) == ("B", [3.0, 4.0, 0.0], math.inf, None)


def test_range_and_height_may_be_left_out(tmp_path: Path) -> None:
    (a,) = read_readers(table(tmp_path, "name;x_m;y_m\nA;1;2\n"))
    assert a.position.tolist() == [1.0, 2.0, 0.0]
    assert math.isinf(a.range)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("reader,x,y,range\nA,1,2,-3\n", "line 2: range is -3; it must be above 0"),
        ("reader,x,y,range\nA,1,2,0\n", "line 2: range is 0; it must be above 0"),
        ("reader,x,y\nA,1,2\nA,3,4\n", "line 3: reader A is there twice"),
        ("reader,x\nA,1\n", "has no column y"),
        ("reader,x,y\nA,1,here\n", "line 2: y is 'here'; a number was expected"),
        ("", "is empty"),
    ],
)
def test_a_wrong_table_is_one_line(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(InputError, match=says) as caught:
        read_readers(table(tmp_path, text))
    assert "\n" not in str(caught.value)
