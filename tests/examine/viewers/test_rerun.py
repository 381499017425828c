"""What Rerun shows of a file made for it; skipped where its program is not installed."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from benchmarks.pipeline.viewers import shares, shown_by_rerun
from occlog.cli.main import run
from occlog.errors import ExitCode

RERUN = os.environ.get("OCCLOG_RERUN") or shutil.which("rerun")
SAMPLE = Path(__file__).resolve().parents[3] / "sample_data" / "room" / "recording.mcap"


@pytest.mark.skipif(RERUN is None, reason="rerun is not installed: pip install rerun-sdk, or OCCLOG_RERUN names it")
def test_rerun_shows_all_of_the_sample_that_was_exported_for_it(tmp_path: Path) -> None:
    assert RERUN is not None
    path = tmp_path / "r.mcap"
    assert run(["export", str(SAMPLE), "--to", "rerun", "-o", str(path), "-q"]) == ExitCode.DONE
    drawn, known, others = shares(RERUN, path)
    assert (drawn, known, list(others)) == (1.0, 1.0, [])
    images, _ = shown_by_rerun(RERUN, SAMPLE)
    assert not {topic for topic in images if topic.startswith(("/camera", "/truth"))}  # of the recording itself nothing
