"""Method `imm` against a bootstrap particle filter of Stone Soup on the same bearings; see `_stone_soup`.

Both have equally many particles in all, a third of them under each of the three models of `imm`; Stone Soup has one
model, which is less work.
"""

from __future__ import annotations

from typing import Any

from benchmarks.peers._stone_soup import compare
from benchmarks.track import _imm_problem as problem
from benchmarks.track._imm_problem import PARTICLES, SIGMA, SIGMA_V, SPREAD, START, STEP_S
from benchmarks.track.imm import whole
from occlog.array_types import Floats

NAME = "imm-stonesoup"
SUMMARY = "step of imm, 5000 particles under 3 models, 3 bearings: processor time to that of Stone Soup with 15000"
LIMIT = 0.1


def run(repeats: int = 3) -> dict[str, Any]:
    """Ratio of the times of a step; median over repeats, taken in turn."""
    given = problem.recording()

    def ours() -> tuple[float, Floats]:
        time_us, states = whole(given)
        return time_us, states[:, ::2]

    arrays = {
        "angle": given.angle,
        "truth": given.truth,
        "start": START,
        "spread": SPREAD,
        "sigma": SIGMA,
        "step_s": STEP_S,
        "density": SIGMA_V**2,
        "particles": 3 * PARTICLES,
    }
    return {"limit": LIMIT, **compare(ours, given.truth, "bearings", arrays, repeats)}
