"""The examples keep their promises: those with Stone Soup and norfair where these are installed."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest
from places import ROOT

from occlog.conformance import filters, view_trackers
from occlog.conformance.faults import faults_by

EXAMPLES = ROOT / "examples/plugins"


def test_examples_are_short() -> None:
    files = [path for path in EXAMPLES.glob("*/*.py") if path.stem != "__init__"]
    assert len(files) == 5
    assert all(len(path.read_text(encoding="utf-8").splitlines()) < 100 for path in files)
    assert all((path.parent / "pyproject.toml").is_file() for path in files)


@pytest.mark.slow
def test_a_filter_of_stone_soup_has_no_fault(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(EXAMPLES / "stone_soup"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        pytest.importorskip("stonesoup", reason="Stone Soup is not installed")
        from stone_soup_filter import StoneSoupFilter  # type: ignore[import-not-found]

    assert faults_by(filters.CHECKS, StoneSoupFilter) == []


@pytest.mark.slow
def test_a_tracker_of_norfair_has_no_fault(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(EXAMPLES / "norfair_tracker"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        pytest.importorskip("norfair", reason="norfair is not installed")
        from norfair_tracker import NorfairTracker  # type: ignore[import-not-found]

    assert faults_by(view_trackers.CHECKS, NorfairTracker) == []
