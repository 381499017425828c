"""Effective numbers of particles over a run."""

from __future__ import annotations

import math

import numpy as np
import pytest

from occlog.consistency.estimates import MIN_EFFECTIVE_SAMPLE_SIZE, EffectiveSampleSizes


def test_quantities_of_a_run_do_not_depend_on_how_its_rows_come() -> None:
    rng = np.random.default_rng(0)
    ess = 10 ** rng.uniform(0, 3.3, 5001)
    found = EffectiveSampleSizes()
    for part in np.array_split(ess, 9):
        found.add(part)
    assert found.rows == 5001
    assert found.mean == pytest.approx(ess.mean())
    assert found.median == pytest.approx(np.median(ess), rel=0.03)
    assert found.few == np.count_nonzero(ess < MIN_EFFECTIVE_SAMPLE_SIZE)


def test_ten_are_enough_and_less_are_few() -> None:
    found = EffectiveSampleSizes()
    found.add(np.array([MIN_EFFECTIVE_SAMPLE_SIZE, np.nextafter(MIN_EFFECTIVE_SAMPLE_SIZE, 0.0), 1.0]))
    assert found.few == 2


def test_methods_without_particles_have_no_figures() -> None:
    found = EffectiveSampleSizes()
    found.add(np.full(5, np.nan))
    assert found.rows == found.few == 0
    assert math.isnan(found.mean)
    assert math.isnan(found.median)


def test_one_particle_is_the_least() -> None:
    found = EffectiveSampleSizes()
    found.add(np.ones(3))
    assert found.median == pytest.approx(1.0, rel=0.03)
