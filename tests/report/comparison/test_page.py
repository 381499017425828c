"""The page of two runs: what it holds for its script, how large it gets, and that names are never markup."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from two_runs import STEP, exchanged_at, lost, moved, tracks, truth, write_run

from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.records.losses import Loss
from occlog.records.tables import PeopleTracks
from occlog.report.comparison import plots
from occlog.report.comparison.config import RunComparisonConfig
from occlog.report.comparison.page import build_markdown, build_page
from occlog.report.comparison.run import ReportRun, align_runs
from occlog.report.comparison.words import RunComparisonPage
from occlog.report.content.downsampled import MAX_SHOWN
from occlog.report.content.model import ReportInput
from occlog.report.replay.steps import KINDS, MISSING

EVIL = "</script><script>window.evil=1</script>\"'><img src=x onerror=window.evil=2>"
CONFIG = RunComparisonConfig(match_distance=1.0, divergence_distance=0.5)


def beside(
    a: PeopleTracks, b: PeopleTracks, folder: Path | None = None, names: tuple[str, str] = ("a", "b")
) -> RunComparisonPage:
    """Two runs; with the truth where there is a folder to write them into."""
    files = [Path("a"), Path("b")]
    given = None
    if folder is not None:
        files = [write_run(folder / k, table) / "tracks.parquet" for k, table in (("a", a), ("b", b))]
        frames = int(a.t_ns[-1]) // STEP + 1
        write_table(folder / "truth.parquet", truth(frames), Provenance("simulate"), overwrite=True)
        given = (folder / "truth.parquet", truth(frames))
    runs = [ReportRun(n, f, t, ReportInput(title=n, tracks=t)) for n, f, t in zip(names, files, (a, b), strict=True)]
    return replace(align_runs(*runs, given, CONFIG, 0), title="Two runs")


def packed(value: list[Any]) -> np.ndarray:
    """Numbers of the page, as its script unpacks them."""
    if value[0] == "=":
        return np.full(value[1], value[2])
    return np.frombuffer(base64.b64decode(value[1]), KINDS[value[0]])


def data_of(page: str) -> dict[str, Any]:
    found = re.search(r'<script type="application/json" id="replay-data">(.*?)</script>', page)
    assert found
    data: dict[str, Any] = json.loads(found[1])
    return data


def test_both_plans_have_the_same_moments_and_partners() -> None:
    a, b = tracks(), tracks(60, lost(2, 30, 44))
    page = build_page(beside(a, b))
    data = data_of(page)
    np.testing.assert_allclose(packed(data["times"]), np.arange(60) * 0.1)
    assert data["a"]["limits"] == data["b"]["limits"]
    assert data["a"]["colours"] == data["b"]["colours"] == [0, 1, 2]
    partner = packed(data["partner"])
    first = packed(data["a"]["tracks"]["first"])
    for frame in (0, 29, 30, 44, 45):
        own = partner[first[frame] : first[frame + 1]].tolist()
        assert own == ([0, 1, MISSING] if 30 <= frame < 45 else [0, 1, 2])
    assert packed(data["alone"]).tolist() == [int(30 <= k < 45) for k in range(60)]
    assert np.diff(packed(data["b"]["tracks"]["first"])).tolist() == [2 if 30 <= k < 45 else 3 for k in range(60)]


def test_people_whom_one_run_alone_has_are_grey() -> None:
    def another(frame: np.ndarray, label: np.ndarray, x: np.ndarray, y: np.ndarray) -> None:
        y[label == 12] += 50.0
        label[label == 12] = 40

    data = data_of(build_page(beside(tracks(), tracks(60, another))))
    assert data["a"]["colours"] == [0, 1, -1]
    assert data["b"]["colours"] == [0, 1, -1]


def test_true_places_are_once_in_the_page_and_switches_are_marked(tmp_path: Path) -> None:
    data = data_of(build_page(beside(tracks(), tracks(60, exchanged_at(25)), tmp_path)))
    assert data["a"]["truth"]
    assert data["b"]["truth"] == {}
    assert data["changes"] == [2.5]


def test_long_runs_are_thinned_but_keep_the_moments_that_the_page_leads_to(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a tenth of the estimates that a page may show, in a tenth of the bytes."""
    assert MAX_SHOWN == 45_000
    monkeypatch.setattr(plots, "MAX_SHOWN", MAX_SHOWN // 10)
    frames = 1201
    found = beside(tracks(frames), tracks(frames, moved(1, 701, 701, 0.7)))
    page = build_page(found)
    data = data_of(page)
    times = packed(data["times"])
    every = -(-2 * 3 * frames // (MAX_SHOWN // 10))
    assert every == 2
    assert len(times) == len(range(0, frames, every)) + 1
    k = int(np.searchsorted(times, 70.1 - 1e-9))
    assert times[k] == 70.1
    assert packed(data["apart"])[k] == 0.7
    assert len(page) - len(build_page(beside(tracks(), tracks()))) < 200_000
    assert f"{len(times):,} of {frames:,} time steps: every 2-th." in page


def test_the_largest_distance_between_kept_moments_is_not_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plots, "MAX_SHOWN", MAX_SHOWN // 10)
    frames = 1201
    change = moved(1, 601, 603, 0.7)
    data = data_of(build_page(beside(tracks(frames), tracks(frames, change))))
    apart = packed(data["apart"])
    times = packed(data["times"])
    assert set(np.round(times[apart > 0.5], 6).tolist()) == {60.1, 60.2, 60.4}


@pytest.mark.drawn
def test_names_and_findings_are_text(tmp_path: Path) -> None:
    found = beside(tracks(), tracks(60, exchanged_at(25)), tmp_path, (EVIL, EVIL + "2"))
    doubt = tracks(60, quality_flags=np.full(180, EVIL), seen_by=np.full(180, EVIL))
    side = replace(
        found.a, tracks=doubt, data=replace(found.a.data, losses=(Loss(EVIL, EVIL, EVIL, 1),), metrics={EVIL: 1.0})
    )
    evil = replace(found, title=EVIL, a=side, notes=(EVIL,), provenance={EVIL: EVIL})
    page = build_page(evil)
    assert EVIL not in page
    assert "<img" not in page
    assert page.count("<script") == page.count("</script") == 2
    text = build_markdown(evil)
    assert "\\<script\\>" in text
    assert "<img" not in text.replace("\\<img", "")


def test_markdown_rows_have_as_many_cells_as_their_heads(tmp_path: Path) -> None:
    text = build_markdown(beside(tracks(), tracks(60, exchanged_at(25)), tmp_path, ("one | x", "two\n# y")))
    lines = text.splitlines()
    assert "# Two runs" in lines
    assert "- B: two \\# y" in lines
    tables = [k for k, line in enumerate(lines) if re.fullmatch(r"\|(-+:?\|)+", line)]
    assert len(tables) == 4
    for k in tables:
        wide = len(re.findall(r"(?<!\\)\|", lines[k]))
        rows = [line for line in lines[k:] if line.startswith("|")][:3]
        assert all(len(re.findall(r"(?<!\\)\|", line)) == wide for line in [lines[k - 1], *rows[:2]])
