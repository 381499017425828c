"""Makes the golden outputs: `python -m tests.golden.make` (or `make golden`) replaces those in `expected`."""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

from occlog.cli.main import run

HERE = Path(__file__).resolve().parent
EXPECTED = HERE / "expected"
SAMPLE = HERE.parents[1] / "sample_data" / "room" / "recording.mcap"
NOT_KEPT = ("report.html", "report.png", "report.md", "run.json")
"""Drawings depend on the version of the plotting library; their content is tested elsewhere."""


def simulated_run(folder: Path) -> None:
    """All stages of a small simulated run."""
    _must(["run", str(HERE / "run.yaml"), "-o", str(folder), "-q"])
    for name in NOT_KEPT:
        (folder / name).unlink()


def detected_room(folder: Path) -> None:
    """Detection in the video that comes with occlog, from the first observation to the bearings."""
    folder.mkdir()
    out = ["-o", str(folder / "bearings.parquet"), "--views", str(folder / "views.parquet")]
    _must(["detect", str(SAMPLE), *out, "-q"])


PARTS = {"simulated": simulated_run, "room": detected_room}


def _must(args: list[str]) -> None:
    code = run(args)
    if code not in (0, 3):
        raise RuntimeError(f"occlog {' '.join(args)} ended with {code}")


def main() -> None:
    """Replace the golden outputs once all of them could be made."""
    with tempfile.TemporaryDirectory(dir=HERE) as name:
        for part, make in PARTS.items():
            make(Path(name) / part)
        shutil.rmtree(EXPECTED, ignore_errors=True)
        shutil.copytree(name, EXPECTED)
    print(f"wrote {EXPECTED}", file=sys.stderr)  # noqa: T201


if __name__ == "__main__":
    main()
