"""Limits of text tables: cells, lines, numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from occlog.errors import InputError
from occlog.io.files.texts.csv_rows import MAX_CELL, CsvRows, no_formula, plain_text, read_rows

COLUMNS = {"a": ("a", "first"), "b": ("b",)}


def read(folder: Path, text: str, **options: int) -> list[CsvRows]:
    path = folder / "t.csv"
    path.write_text(text)
    return list(read_rows(path, COLUMNS, "a table", **options))


@pytest.mark.parametrize(("length", "good"), [(MAX_CELL, True), (MAX_CELL + 1, False)])
def test_a_cell_has_at_most_so_many_characters(tmp_path: Path, length: int, good: bool) -> None:
    text = "a,b\n1,2\n3," + "x" * length + "\n"
    if good:
        assert len(read(tmp_path, text)[0]) == 2
    else:
        with pytest.raises(InputError, match=f"line 3: a cell of more than {MAX_CELL} characters"):
            read(tmp_path, text)


@pytest.mark.parametrize(("length", "good"), [(1_000_000, True), (1_000_001, False)])
def test_a_line_has_at_most_a_million_characters(tmp_path: Path, length: int, good: bool) -> None:
    row = "1,2"
    text = "a,b\n" + row + " " * (length - len(row) - 1) + "\n"
    if good:
        assert len(read(tmp_path, text)[0]) == 1
    else:
        with pytest.raises(InputError, match="line 2: longer than"):
            read(tmp_path, text)


def test_chunks_have_the_number_of_rows_that_is_asked_for(tmp_path: Path) -> None:
    text = "a,b\n" + "1,2\n" * 7
    assert [len(part) for part in read(tmp_path, text, rows=3)] == [3, 3, 1]
    assert [len(part) for part in read(tmp_path, text, rows=7)] == [7]


def test_whole_numbers_are_read_up_to_the_last_that_a_float_can_tell_apart(tmp_path: Path) -> None:
    assert read(tmp_path, f"a\n3.0\n{2**53 - 1}.0\n")[0].ints("a").tolist() == [3, 2**53 - 1]
    assert read(tmp_path, f"a\n{2**63 - 1}\n")[0].ints("a").tolist() == [2**63 - 1]
    for bad in ("3.5", f"{2**53}.0"):
        with pytest.raises(InputError, match=r"line 3: a is .*; a whole number was expected"):
            read(tmp_path, f"a\n1.0\n{bad}\n")[0].ints("a")


def test_blank_cells_are_nan_only_where_they_may_be(tmp_path: Path) -> None:
    (rows,) = read(tmp_path, "a,b\n1,\n2,NaN\n3,none\n4,5e-1\n")
    np.testing.assert_array_equal(rows.floats("b", blank=True), [np.nan, np.nan, np.nan, 0.5])
    with pytest.raises(InputError, match="line 2: b is missing"):
        rows.floats("b")
    with pytest.raises(InputError, match="line 2: a is 'inf'; a finite number was expected"):
        read(tmp_path, "a\ninf\n")[0].floats("a", blank=True)


def test_numbers_are_not_spelt_as_in_python(tmp_path: Path) -> None:
    (rows,) = read(tmp_path, "a,b\n1,1.5\n2_0,2_0\n")
    with pytest.raises(InputError, match="line 3: a is '2_0'; a number was expected"):
        rows.ints("a")
    with pytest.raises(InputError, match="line 3: b is '2_0'; a number was expected"):
        rows.floats("b")


@pytest.mark.parametrize("text", ["=cmd|calc!A1", "+1+1", "-a", "@x", "\tx", "'=x", "''@"])
def test_what_a_spreadsheet_takes_for_a_formula_is_marked_and_comes_back(text: str) -> None:
    assert no_formula(text) == "'" + text
    assert plain_text(no_formula(text)) == text


@pytest.mark.parametrize("text", ["", "cam1", "-1.5", "+2e-3", "'cam'", "a=b", "x@y"])
def test_other_texts_and_numbers_stay_as_they_are(text: str) -> None:
    assert no_formula(text) == plain_text(text) == text


def test_tabs_at_the_ends_of_a_line_are_cells_without_a_value(tmp_path: Path) -> None:
    """Such lines were refused for lack of a cell."""
    (rows,) = read(tmp_path, "a\tb\n1\t2\n3\t\n\t4\n")
    assert rows.cells["a"].tolist() == ["1", "3", ""]
    assert rows.cells["b"].tolist() == ["2", "", "4"]
