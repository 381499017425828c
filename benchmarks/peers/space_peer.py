"""`direct3d` against a bootstrap particle filter of Stone Soup on the same azimuths and elevations."""

from __future__ import annotations

from typing import Any

from benchmarks.peers._stone_soup import compare
from benchmarks.track import _space_problem as problem
from benchmarks.track.space import PARTICLES, STEPS, ours_in_space
from occlog.array_types import Floats

NAME = "stonesoup"
SUMMARY = "step of direct3d, 10000 particles, 3 arrays: processor time to that of a particle filter of Stone Soup"
LIMIT = 0.1


def run(repeats: int = 3) -> dict[str, Any]:
    """Ratio of the times of a step over the same recording; median over repeats, taken in turn."""
    given = problem.recording(STEPS)
    truth = given.truth[:, :3]

    def ours() -> tuple[float, Floats]:
        time_us, states = ours_in_space(given)
        return time_us, states[:, :3]

    arrays = {
        "theta": given.theta,
        "phi": given.phi,
        "truth": truth,
        "start": given.start,
        "spread": problem.SPREAD,
        "places": problem.PLACES,
        "sigma": problem.SIGMA,
        "step_s": problem.STEP_S,
        "density": problem.DENSITY,
        "particles": PARTICLES,
    }
    return {"limit": LIMIT, **compare(ours, truth, "directions", arrays, repeats)}
