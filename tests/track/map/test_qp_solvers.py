"""General solvers behind method `map`: signs of their answers, and a package that is missing."""

from __future__ import annotations

import importlib
from dataclasses import replace

import numpy as np
import pytest
from map_scenes import place, record, scans_of
from numpy.testing import assert_allclose
from scipy import sparse

from occlog.errors import UsageError
from occlog.track.methods.map.config import PACKAGES, MapConfig
from occlog.track.methods.map.kernels.quadratic_program import Program
from occlog.track.methods.map.method import advance, begin
from occlog.track.methods.map.qp_solvers import program_solver


@pytest.mark.parametrize("name", PACKAGES)
def test_a_program_whose_answer_is_known(name: str) -> None:
    """Nearest point to (2, 1) with x <= 1 and y <= 3: (1, 1); the first constraint pushes back with force 1."""
    P, q = sparse.csc_matrix(np.eye(2)), np.array([-2.0, -1.0])
    A, b = sparse.csc_matrix(-np.eye(2)), np.array([1.0, 3.0])
    d, multiplier = program_solver(name)(Program(P, q, A, b))
    assert_allclose(d, [1.0, 1.0], atol=1e-6)
    assert_allclose(multiplier, [1.0, 0.0], atol=1e-6)
    assert_allclose(np.eye(2) @ d + q - A.T @ multiplier, 0.0, atol=1e-6)


@pytest.mark.parametrize("name", PACKAGES)
def test_a_program_without_constraints(name: str) -> None:
    P = sparse.csc_matrix(np.array([[2.0, 0.5], [0.5, 1.0]]))
    d, multiplier = program_solver(name)(Program(P, np.array([1.0, 1.0]), sparse.csc_matrix((0, 2)), np.empty(0)))
    assert_allclose(P @ d, [-1.0, -1.0], atol=1e-6)
    assert len(multiplier) == 0


@pytest.mark.parametrize("name", PACKAGES)
def test_a_missing_package_is_one_line(name: str, monkeypatch) -> None:
    whole = importlib.import_module

    def without(wanted: str, *args):
        if wanted == name:
            raise ImportError(f"No module named {name!r}")
        return whole(wanted, *args)

    monkeypatch.setattr(importlib, "import_module", without)
    with pytest.raises(UsageError, match=f"solver={name} requires the package {name}, which is not installed") as error:
        program_solver(name)
    assert "\n" not in str(error.value)
    assert "leave the setting out" in str(error.value)


def test_the_setting_gives_the_same_track() -> None:
    scene = place((-4, -3, 90), (4, -3, 90))
    t = np.arange(0.0, 16.0, 0.5)
    made = record(scene, t, np.column_stack([-7.0 + 0.9 * t, 1.0 + 0.05 * t]))
    config = MapConfig(process_noise_velocity=0.05)
    newton, programs = (
        advance(begin(scene, c), scans_of(made), last=True)[1] for c in (config, replace(config, solver="clarabel"))
    )
    assert programs.converged
    assert_allclose(programs.xy, newton.xy, rtol=0, atol=1e-4)
    assert_allclose(programs.covariance, newton.covariance, rtol=1e-2, atol=1e-8)
