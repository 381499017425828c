"""The tables of occlusion.md are those of benchmarks/core/occlusion_error.py, and its conclusions follow."""

from __future__ import annotations

import numpy as np
import pytest
from places import DOCS

from benchmarks.core.occlusion_error import CROWDS, SHAPES, p_line, p_row, q_line, q_row

TEXT = (DOCS / "explanation/occlusion.md").read_text(encoding="utf-8")


def rows(columns: int) -> list[list[str]]:
    """Cells of the lines of numbers in tables of so many columns."""
    lines = [[c.strip() for c in line.strip("|").split("|")] for line in TEXT.splitlines() if line.startswith("|")]
    return [cells for cells in lines if len(cells) == columns and cells[0].replace(".", "").isdigit()]


def test_rows_are_those_of_the_script() -> None:
    assert [[float(c) for c in row[:3]] for row in rows(8)] == [[s.sigma, s.alpha, s.diameter] for s in SHAPES]
    assert [[float(c) for c in row[:5]] for row in rows(12)] == [list(map(float, crowd)) for crowd in CROWDS]


@pytest.mark.statistics
@pytest.mark.parametrize("index", [2, 10])
def test_errors_of_q_are_as_documented(index: int) -> None:
    np.testing.assert_allclose([float(c) for c in rows(8)[index][4:]], q_row(SHAPES[index]), atol=1.5e-4)


@pytest.mark.jit
@pytest.mark.parametrize("index", [0, 2, 4, 5])
def test_errors_of_p_are_as_documented(index: int) -> None:
    assigned, recursive, free = p_row(CROWDS[index])
    documented = [float(c) for c in rows(12)[index][5:]]
    assert documented[0] == pytest.approx(assigned, abs=0.06)
    np.testing.assert_allclose(documented[1:], [*recursive, *free], atol=1.5e-3)


@pytest.mark.statistics
def test_lines_are_written_as_in_the_page() -> None:
    assert len(q_line(SHAPES[5]).split("|")) == 10
    assert q_line(SHAPES[5]) in TEXT  # isotropic: no error in any digit
    assert p_line(CROWDS[0]).split("|")[1:6] == [f" {c} " for c in rows(12)[0][:5]]


def test_conclusions_follow_from_the_tables() -> None:
    q = np.array([[float(c) for c in row[4:]] for row in rows(8)])
    assert np.all(q[:, 2:] <= q[:, :2])  # `improved` is never farther off
    p = np.array([[float(c) for c in row[6:]] for row in rows(12)])
    assert np.all(p[:, 3:] <= p[:, :3])  # neither is `independent`
