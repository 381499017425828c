"""Comparison of a method with a particle filter of Stone Soup: processor time of a step, and error.

Stone Soup runs in an environment of its own: that which OCCLOG_STONESOUP names (a folder with bin/python), or else
one that is made for the run (`pip install stonesoup==1.9.1`); both filters track the same recording, in turn.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from benchmarks.peers._environments import environment, output_of
from occlog.array_types import Floats

VARIABLE = "OCCLOG_STONESOUP"
PACKAGE = "stonesoup==1.9.1"


def compare(
    ours: Callable[[], tuple[float, Floats]], truth: Floats, kind: str, given: Mapping[str, ArrayLike], repeats: int
) -> dict[str, Any]:
    """Return the ratio of the times of a step, and its parts; median over repeats, taken in turn.

    Args:
        ours: one run of our method: time of a step [us], and (T, n) estimated places.
        truth: (T, n) true places.
        kind: filter of `_stone_soup_filters.py`.
        given: arrays that it reads.
        repeats: number of runs of each.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "given.npz"
        np.savez(path, **{name: np.asarray(value) for name, value in given.items()})
        python = environment(Path(os.environ.get(VARIABLE) or Path(folder) / "peer"), PACKAGE)
        ours()  # compile
        own, theirs = [], []
        for _ in range(repeats):
            own.append(ours())
            theirs.append(output_of(python, "_stone_soup_filters.py", kind, path))
    errors = own[-1][1] - truth
    return {
        "ratio": median(a[0] / b["step us"] for a, b in zip(own, theirs, strict=True)),
        "parts": {
            "step us": median(a[0] for a in own),
            "Stone Soup step us": median(b["step us"] for b in theirs),
            "RMSE": float(np.sqrt(np.mean(np.sum(errors**2, axis=1)))),
            "Stone Soup RMSE": theirs[-1]["rmse"],
            "Stone Soup version": theirs[-1]["version"],
        },
    }
