"""Peak memory of `detect` and `track` on a recording ten times as long."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

NAME = "memory"
SUMMARY = "peak memory of detect and track: ten times as long a recording to a short one"
LIMIT = 1.10
SHORT = 60
SCENE = Path(__file__).resolve().parents[2] / "examples" / "room.yaml"


def peak_mb(*args: str) -> float:
    """Largest resident set [MB] of an occlog command that must succeed."""
    pid = os.spawnv(os.P_NOWAIT, sys.executable, [sys.executable, "-m", "occlog", *args, "--quiet", "--overwrite"])
    _, status, usage = os.wait4(pid, 0)
    if os.waitstatus_to_exitcode(status) != 0:
        raise RuntimeError(f"occlog {' '.join(args)} failed")
    return usage.ru_maxrss / 1024


def measure(folder: Path, steps: int) -> dict[str, float]:
    """Peaks of both stages on a rendered recording of that many frames a camera."""
    recording, bearings = folder / f"{steps}.mcap", folder / f"{steps}.parquet"
    made = ["simulate", str(SCENE), "-o", str(recording), "--steps", str(steps), "--render", "--seed", "1"]
    subprocess.run([sys.executable, "-m", "occlog", *made, "--overwrite"], check=True, capture_output=True)
    detect = peak_mb("detect", str(recording), "-o", str(bearings), "--views", str(folder / "views.parquet"))
    track = peak_mb("track", str(bearings), "--scene", str(recording), "-o", str(folder / "tracks.parquet"))
    return {"detect": detect, "track": track}


def run(repeats: int) -> dict[str, Any]:  # noqa: ARG001
    """Ratio of the peaks, the larger of both stages; memory needs no repeats."""
    with tempfile.TemporaryDirectory() as name:
        short, long = (measure(Path(name), steps) for steps in (SHORT, 10 * SHORT))
    ratios = {stage: long[stage] / short[stage] for stage in short}
    parts = {f"{stage}: MB at {SHORT} steps": short[stage] for stage in short}
    parts |= {f"{stage}: MB at {10 * SHORT} steps": long[stage] for stage in long}
    return {"ratio": max(ratios.values()), "limit": LIMIT, "parts": parts}
