"""What Rerun shows of a file made for it; skipped where its program is not installed."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest
from viewer_runs import fill

from benchmarks.pipeline.viewers import shares, shown_by_rerun
from occlog.cli.main import run
from occlog.errors import ExitCode

RERUN = os.environ.get("OCCLOG_RERUN") or shutil.which("rerun")
SAMPLE = Path(__file__).resolve().parents[3] / "sample_data" / "room" / "recording.mcap"


pytestmark = pytest.mark.skipif(
    RERUN is None, reason="rerun is not installed: pip install rerun-sdk, or OCCLOG_RERUN names it"
)


@pytest.mark.parametrize("to", ["viewers", "rerun"])
def test_rerun_shows_all_of_a_run_that_was_exported_for_it(to: str, tmp_path: Path) -> None:
    assert RERUN is not None
    path = tmp_path / "r.mcap"
    assert run(["export", str(fill(tmp_path)), "--to", to, "-o", str(path), "-q"]) == ExitCode.DONE
    assert shares(RERUN, path) == (1.0, set())
    entities = shown_by_rerun(RERUN, path)
    assert {"/targets", "/plan", "/camera/east/image/annotations", "/tracks/3", "/diagnostics/3", "/log"} <= entities


def test_rerun_shows_nothing_of_scenes_and_annotations_alone(tmp_path: Path) -> None:
    assert RERUN is not None
    path = tmp_path / "f.mcap"
    assert run(["export", str(SAMPLE), "--to", "foxglove", "-o", str(path), "-q"]) == ExitCode.DONE
    _, others = shares(RERUN, path)
    assert {"/plan", "/truth"} <= set(others)
    assert not shown_by_rerun(RERUN, SAMPLE)  # nor of the recording itself
