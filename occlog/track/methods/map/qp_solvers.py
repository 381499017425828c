"""General solvers of quadratic programs, which are not installed with occlog itself."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from scipy import sparse

from occlog.array_types import Floats
from occlog.errors import UsageError
from occlog.track.methods.map.kernels.quadratic_program import Program, Solver

OSQP_STEPS = 200_000


def program_solver(name: str) -> Solver:
    """Return the solver of quadratic programs with the given name: a function from a program to its solution.

    The solution is the change of all states, and the multipliers of the constraints.

    Args:
        name: `clarabel` or `osqp`.

    Raises:
        UsageError: the package is not installed.
    """
    try:
        package = importlib.import_module(name)
    except ImportError as error:
        raise UsageError(
            f"solver={name} requires the package {name}, which is not installed; pip install {name}, "
            "or leave the setting out",
            id="missing-package",
        ) from error
    solve = {"clarabel": _clarabel, "osqp": _osqp}[name]
    return lambda program: solve(package, program)


def _clarabel(package: Any, p: Program) -> tuple[Floats, Floats]:
    """Solve a quadratic program with the package clarabel; return the change d (4 T,) and the multipliers (M,) >= 0."""
    settings = package.DefaultSettings()
    settings.verbose = False
    cone = [package.NonnegativeConeT(len(p.b))]
    upper = sparse.triu(p.P).tocsc()
    found = package.DefaultSolver(upper, p.q, (-p.A).tocsc(), p.b, cone, settings).solve()
    return np.array(found.x), np.array(found.z)


def _osqp(package: Any, p: Program) -> tuple[Floats, Floats]:
    """Solve a quadratic program with the package osqp; return the change d (4 T,) and the multipliers (M,) >= 0."""
    solver = package.OSQP()
    solver.setup(
        sparse.triu(p.P).tocsc(),
        p.q,
        p.A.tocsc(),
        -p.b,
        np.full(len(p.b), np.inf),
        verbose=False,
        eps_abs=1e-9,
        eps_rel=1e-9,
        max_iter=OSQP_STEPS,
        polishing=True,
    )
    found = solver.solve(raise_error=False)
    return np.array(found.x), -np.array(found.y)
