"""Time a state and peak memory of whole trajectories as they grow."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.pipeline.memory import peak_mb
from benchmarks.track._batch_problem import sparse_problem
from benchmarks.track.batch import solved

NAME = "batch-growth"
SUMMARY = "time a state of a trajectory of 100,000 states to that of one of 200"
LIMIT = 1.5
SIZES = (200, 2_000, 20_000, 100_000)
SCENE = Path(__file__).resolve().parents[2] / "examples" / "room100.yaml"
STEPS, LAG_S = 2_000, 60


def time_a_state(steps: int, repeats: int) -> tuple[float, float]:
    """Median time a state [us] over problems, and median iterations of the whole; short problems are many."""
    solved(*sparse_problem(200, 0))
    each, iterations = [], []
    for seed in range(max(repeats, 20) if steps <= 2_000 else min(repeats, 3)):
        case = sparse_problem(steps, seed)
        begin = time.perf_counter()
        found = solved(*case)
        each.append((time.perf_counter() - begin) / steps * 1e6)
        iterations.append(found.iterations)
    return sum(each) / len(each) if steps <= 2_000 else median(each), median(iterations)


def lag_memory() -> dict[str, float]:
    """Peak memory [MB] of `track --lag` on recordings of which one is ten times as long as the other."""
    peaks = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for steps in (STEPS, 10 * STEPS):
            recording, tracks = folder / f"{steps}.mcap", folder / f"{steps}.parquet"
            peak_mb("simulate", str(SCENE), "-o", str(recording), "--steps", str(steps))
            options = ("--method", "map", "--lag", str(LAG_S), "-o", str(tracks))
            peaks[f"--lag {LAG_S}: MB at {steps} steps"] = peak_mb("track", str(recording), *options)
    return peaks


def run(repeats: int = 5) -> dict[str, Any]:
    """Ratio of times a state; and the peaks of the fixed-lag form."""
    found = {steps: time_a_state(steps, repeats) for steps in SIZES}
    parts = {f"us a state at {steps} states": us for steps, (us, _) in found.items()}
    parts |= {f"iterations of the whole at {steps} states": n for steps, (_, n) in found.items()}
    return {"ratio": found[SIZES[-1]][0] / found[SIZES[0]][0], "limit": LIMIT, "parts": parts | lag_memory()}
