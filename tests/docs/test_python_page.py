"""The Python of the docs and of the notebooks runs as it stands there."""

from __future__ import annotations

import ast
import json
import re
from pathlib import Path

import pytest
from places import ROOT


@pytest.mark.statistics
def test_the_python_of_the_page_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs/how-to/python.md").read_text(encoding="utf-8")
    names: dict[str, object] = {}
    for block in re.findall(r"```python\n(.*?)```", page, re.DOTALL):
        exec(compile(block, "docs/how-to/python.md", "exec"), names)
    stdout = capsys.readouterr().out.strip()
    assert f"prints `{stdout}`" in page
    assert (tmp_path / "report.html").is_file()


NOTEBOOKS = sorted((ROOT / "examples/notebooks").glob("*.ipynb"))
NEEDS = {"tables-with-duckdb": "duckdb"}
"""Notebooks that need a package which occlog does not."""


def code_cells(path: Path) -> list[str]:
    """The code of a notebook; its outputs are stripped."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in code)
    return ["".join(cell["source"]) for cell in code]


def run_cell(source: str, names: dict[str, object]) -> object:
    """The value of a cell's last expression, after everything before it; None: it ends in a statement."""
    tree = ast.parse(source)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, "cell", "exec"), names)
    return None if last is None else eval(compile(ast.Expression(last.value), "cell", "eval"), names)  # type: ignore[attr-defined]


def test_there_are_four_notebooks_and_they_have_no_magic() -> None:
    assert len(NOTEBOOKS) == 4
    for path in NOTEBOOKS:
        assert not any(line.startswith(("%", "!")) for cell in code_cells(path) for line in cell.splitlines())


@pytest.mark.statistics
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_run_from_top_to_bottom(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if path.stem in NEEDS:
        pytest.importorskip(NEEDS[path.stem], reason=f"{NEEDS[path.stem]} is not installed")
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    shown = [run_cell(cell, names) for cell in code_cells(path)]
    pages = [str(page()) for value in shown if (page := getattr(value, "_repr_html_", None)) is not None]
    assert any("<table" in page for page in pages)
    JUDGED[path.stem](names)


def tracks_everybody(names: dict[str, object]) -> None:
    metrics = names["figures"].metrics  # type: ignore[attr-defined]
    assert metrics["idf1"] > 0.8, metrics["idf1"]


def prefers_a_lively_target(names: dict[str, object]) -> None:
    runs = names["runs"]
    assert runs.groupby("process_noise_position").rmse_m.mean().notna().all()  # type: ignore[attr-defined]
    assert len(runs) == 12  # type: ignore[arg-type]


def is_near_the_bound(names: dict[str, object]) -> None:
    compared: dict[str, dict[str, float]] = names["compared"]  # type: ignore[assignment]
    assert 0.5 < compared["mine"]["bound_ratio"] < 4.0


def finds_the_worst(names: dict[str, object]) -> None:
    assert names["worst"]["error"].is_monotonic_decreasing  # type: ignore[index]


JUDGED = {
    "boxes-to-tracks": tracks_everybody,
    "sweep": prefers_a_lively_target,
    "own-filter": is_near_the_bound,
    "tables-with-duckdb": finds_the_worst,
}
"""What each notebook must have found."""
