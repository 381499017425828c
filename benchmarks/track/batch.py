"""Whole trajectories: Newton's method on the chain against general solvers of quadratic programs."""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable
from statistics import median
from typing import Any

import numpy as np

from benchmarks.track._batch_problem import sparse_problem
from occlog.array_types import Floats
from occlog.track.methods.map.config import PACKAGES
from occlog.track.methods.map.kernels.interior_point import MU_LAST, Options, Solution, minimise
from occlog.track.methods.map.kernels.problem import TrajectoryProblem
from occlog.track.methods.map.kernels.quadratic_program import program, sequential_programs
from occlog.track.methods.map.kernels.windows import minimise_windows
from occlog.track.methods.map.qp_solvers import program_solver

NAME = "trajectory"
SUMMARY = "trajectory of 20,000 states: time of Newton on the chain to that of the same problem by Clarabel's programs"
LIMIT = 1 / 20
STEPS, SHORT = 20_000, 2_000
WINDOW = 512
AGREE = 1e-4
"""Largest difference of positions [m] at which two solutions are one."""


def newton(problem: TrajectoryProblem, start: Floats, extent: float) -> Floats:
    """States by occlog, as `track` finds them."""
    return solved(problem, start, extent).X


def solved(problem: TrajectoryProblem, start: Floats, extent: float) -> Solution:
    """The whole trajectory, after its windows where it has several; iterations are those of the whole."""
    options = Options(1e-7 * extent)
    if problem.T > WINDOW:
        rough = options._replace(tolerance=1e-3 * extent)
        start, _ = minimise_windows(problem, start, WINDOW, lambda p, X, _: (p, minimise(p, X, rough)))
        options = options._replace(mu=MU_LAST)
    return minimise(problem, start, options)


def programs(name: str) -> Callable[[TrajectoryProblem, Floats, float], Floats]:
    """States by the paper's sequence of programs, with a general solver."""
    solver = program_solver(name)

    def run_programs(problem: TrajectoryProblem, start: Floats, extent: float) -> Floats:
        return sequential_programs(problem, start, Options(1e-6 * extent, 100), solver).X

    return run_programs


def run(repeats: int = 3) -> dict[str, Any]:
    """Ratio of times of the whole search; both start from the paper's initial guess and find the same trajectory."""
    sparse = sparse_problem(SHORT, 1)
    newton(*sparse)
    parts: dict[str, Any] = {}
    if importlib.util.find_spec("clarabel") is None:
        return {"ratio": float("nan"), "limit": LIMIT, "parts": {"clarabel": "not installed"}}
    ours, theirs, apart = [], [], []
    for seed in range(min(repeats, 2)):
        problem = sparse_problem(STEPS, seed)
        a, X = _timed(newton, problem)
        b, Y = _timed(programs("clarabel"), problem)
        ours.append(a)
        theirs.append(b)
        apart.append(float(np.mean(np.abs(X - Y)[:, ::2].max(axis=1) > AGREE)))
    parts |= {"occlog s": median(ours), "Clarabel s": median(theirs), "share of states apart": max(apart)}
    parts |= _one_program(sparse_problem(STEPS, 0))
    for name in PACKAGES:
        if importlib.util.find_spec(name) is not None:
            fast, slow = _timed(newton, sparse)[0], _timed(programs(name), sparse)[0]
            parts[f"{SHORT} states: {name} to occlog"] = slow / fast
    return {"ratio": median(a / b for a, b in zip(ours, theirs, strict=True)), "limit": LIMIT, "parts": parts}


def _one_program(case: tuple[TrajectoryProblem, Floats, float]) -> dict[str, float]:
    """Time of one program about the initial guess, and of one of our iterations there."""
    problem, start, extent = case
    each, solver = program(problem, start), program_solver("clarabel")
    begin = time.perf_counter()
    solver(each)
    one = time.perf_counter() - begin
    begin = time.perf_counter()
    minimise(problem, start, Options(1e-7 * extent, 10))
    return {"Clarabel, one program s": one, "occlog, one iteration s": (time.perf_counter() - begin) / 10}


def _timed(
    search: Callable[[TrajectoryProblem, Floats, float], Floats], case: tuple[TrajectoryProblem, Floats, float]
) -> tuple[float, Floats]:
    begin = time.perf_counter()
    X = search(*case)
    return time.perf_counter() - begin, X
