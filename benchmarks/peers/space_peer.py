"""`direct3d` against a bootstrap particle filter of Stone Soup on the same azimuths and elevations.

Stone Soup runs in an environment of its own: that which OCCLOG_STONESOUP names (a folder with bin/python), or else
one that is made for the run (`pip install stonesoup==1.9.1`); both filters track the same recording, in turn.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from benchmarks.peers.particles_peer import alone
from benchmarks.track import _space_problem as problem
from benchmarks.track._space_problem import Recording
from benchmarks.track.space import PARTICLES, STEPS, ours_in_space

NAME = "stonesoup"
SUMMARY = "step of direct3d, 10000 particles, 3 arrays: processor time to that of a particle filter of Stone Soup"
LIMIT = 0.1
VARIABLE = "OCCLOG_STONESOUP"


def run(repeats: int = 3) -> dict[str, Any]:
    """Ratio of the times of a step over the same recording; median over repeats, taken in turn."""
    given = problem.recording(STEPS)
    with tempfile.TemporaryDirectory() as folder:
        python, path = environment(Path(folder)), Path(folder) / "given.npz"
        save(path, given)
        ours_in_space(given)
        ours, theirs = [], []
        for _ in range(repeats):
            ours.append(ours_in_space(given))
            theirs.append(_theirs(python, path))
    errors = ours[-1][1][:, :3] - given.truth[:, :3]
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


def environment(folder: Path) -> Path:
    """The Python of an environment with Stone Soup."""
    named = os.environ.get(VARIABLE)
    if named:
        return Path(named) / "bin" / "python"
    subprocess.run([sys.executable, "-m", "venv", str(folder / "peer")], check=True)
    python = folder / "peer" / "bin" / "python"
    command = [python, "-m", "pip", "install", "--quiet", "stonesoup==1.9.1"]
    subprocess.run(command, check=True, capture_output=True, env=alone())
    return python


def save(path: Path, given: Recording) -> None:
    """What the other filter needs."""
    np.savez(
        path,
        theta=given.theta,
        phi=given.phi,
        truth=given.truth,
        start=given.start,
        spread=problem.SPREAD,
        places=problem.PLACES,
        sigma=problem.SIGMA,
        step_s=problem.STEP_S,
        density=problem.DENSITY,
        particles=PARTICLES,
    )


def _theirs(python: Path, given: Path) -> dict[str, Any]:
    peer = Path(__file__).resolve().parent / "_space_peer.py"
    done = subprocess.run([python, peer, given], check=True, capture_output=True, text=True, env=alone())
    result: dict[str, Any] = json.loads(done.stdout)
    return result
