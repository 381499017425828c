"""Which truth a run gets."""

from __future__ import annotations

from pathlib import Path

import pytest

from occlog.errors import InputError
from occlog.evaluate.compare.run import runs_of


def files(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("")
    return folder


def test_two_runs_of_one_last_name_do_not_get_the_same_truth(tmp_path: Path) -> None:
    """Both were compared with the truth of one of them."""
    runs = files(tmp_path / "runs", "a/run1/tracks.parquet", "b/run1/tracks.parquet")
    truth = files(tmp_path / "truth", "run1.mcap")
    with pytest.raises(InputError, match=r"run1.mcap: is the truth of both runs a/run1 and b/run1; give each"):
        runs_of(runs, truth)
    files(truth, "a/run1.mcap", "b/run1.mcap")
    found = runs_of(runs, truth)
    assert {name: run.truth.relative_to(truth).as_posix() for name, run in found.items()} == {
        "a/run1": "a/run1.mcap",
        "b/run1": "b/run1.mcap",
    }


def test_two_truths_of_one_name_are_refused(tmp_path: Path) -> None:
    """The first in the order of the alphabet was taken."""
    runs = files(tmp_path / "runs", "run1/tracks.parquet")
    truth = files(tmp_path / "truth", "run1.mcap", "run1.avi")
    assert runs_of(runs, truth)["run1"].truth == truth / "run1.mcap"
    files(truth, "run1.csv")
    with pytest.raises(InputError, match=r"run1.csv and run1.mcap could both be the truth of the run run1; keep one"):
        runs_of(runs, truth)
