"""Method `imm` against a bootstrap particle filter of Stone Soup on the same bearings; see `space_peer`.

Both have equally many particles in all, a third of them under each of the three models of `imm`; Stone Soup has one
model, which is less work.
"""

from __future__ import annotations

import json
import subprocess
import tempfile
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from benchmarks.peers.particles_peer import alone
from benchmarks.peers.space_peer import environment
from benchmarks.track import _imm_problem as problem
from benchmarks.track._imm_problem import PARTICLES, SIGMA, SIGMA_V, SPREAD, START, STEP_S, Recording
from benchmarks.track.imm import whole

NAME = "imm-stonesoup"
SUMMARY = "step of imm, 5000 particles under 3 models, 3 bearings: processor time to that of Stone Soup with 15000"
LIMIT = 0.1


def run(repeats: int = 3) -> dict[str, Any]:
    """Ratio of the times of a step; median over repeats, taken in turn."""
    given = problem.recording()
    with tempfile.TemporaryDirectory() as folder:
        python, path = environment(Path(folder)), Path(folder) / "given.npz"
        save(path, given)
        whole(given)
        ours, theirs = [], []
        for _ in range(repeats):
            ours.append(whole(given))
            theirs.append(_theirs(python, path))
    errors = ours[-1][1][:, ::2] - given.truth
    return {
        "ratio": median(a[0] / b["step us"] for a, b in zip(ours, theirs, strict=True)),
        "limit": LIMIT,
        "parts": {
            "step us": median(a[0] for a in ours),
            "Stone Soup step us": median(b["step us"] for b in theirs),
            "RMSE": float(np.sqrt(np.mean(np.sum(errors**2, axis=1)))),
            "Stone Soup RMSE": theirs[-1]["rmse"],
            "Stone Soup version": theirs[-1]["version"],
        },
    }


def save(path: Path, given: Recording) -> None:
    """What the other filter needs."""
    np.savez(
        path,
        angle=given.angle,
        truth=given.truth,
        start=START,
        spread=SPREAD,
        sigma=SIGMA,
        step_s=STEP_S,
        density=SIGMA_V**2,
        particles=3 * PARTICLES,
    )


def _theirs(python: Path, given: Path) -> dict[str, Any]:
    peer = Path(__file__).resolve().parent / "_imm_peer.py"
    done = subprocess.run([python, peer, given], check=True, capture_output=True, text=True, env=alone())
    result: dict[str, Any] = json.loads(done.stdout)
    return result
