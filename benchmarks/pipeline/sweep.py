"""A sweep with two processes against the same sweep with one: time, start of the processes included."""

from __future__ import annotations

import time
from pathlib import Path
from statistics import median
from typing import Any

from occlog.pipeline.sweep.engine import run_all

NAME = "sweep"
SUMMARY = "sweep of 40 trials of 500 steps (40 occluders, priors): time with two processes to that with one"
LIMIT = 1 / 1.8
SCENE = Path(__file__).resolve().parents[2] / "examples" / "room100.yaml"
TRIALS = 40
STEPS = 500


def specs(seed: int) -> list[dict[str, Any]]:
    """Trials of the reference scene, each in a world of its own."""
    scene = SCENE.read_text(encoding="utf-8")
    return [
        {
            "scene": scene,
            "seed": seed,
            "run": run,
            "simulate": {"steps": STEPS, "occluders": 40},
            "observe": {"diameter": 3.33},
            "priors": {"kind": "kalman", "sigma": 8.0, "q": 1.2},
            "track": {"method": "apf", "particles": 1000},
        }
        for run in range(TRIALS)
    ]


def run(repeats: int = 3) -> dict[str, Any]:
    """Ratio of wall-clock times, both taken in turn; median over repeats."""
    run_all(specs(1000)[:1])
    one, two = [], []
    for k in range(min(repeats, 3)):
        a, first = _timed(specs(k), 1)
        b, second = _timed(specs(k), 2)
        if [r["rmse"] for r in first] != [r["rmse"] for r in second]:
            raise AssertionError("results depend on the number of processes")
        one.append(a)
        two.append(b)
    ratio = median(b / a for a, b in zip(one, two, strict=True))
    return {
        "ratio": ratio,
        "limit": LIMIT,
        "parts": {
            "one process s": median(one),
            "two processes s": median(two),
            "throughput of two to one": 1.0 / ratio,
        },
    }


def _timed(trials: list[dict[str, Any]], workers: int) -> tuple[float, list[dict[str, float]]]:
    begin = time.perf_counter()
    results = run_all(trials, workers)
    return time.perf_counter() - begin, results
