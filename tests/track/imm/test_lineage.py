"""Families of particles: how many there are, and when the motion has made up for those that were lost."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.track.methods.imm.tracks import REJUVENATION_VARIANCE_SHARE, Genealogy, is_rejuvenated, new_genealogy


def test_each_particle_is_a_family_at_first_and_draws_leave_fewer() -> None:
    first = new_genealogy(100)
    assert first.effective() == pytest.approx(100.0)
    half = first.drawn(np.repeat(np.arange(50), 2), 0.5)
    assert half.effective() == pytest.approx(50.0)
    assert half.since_s == 0.5
    one = half.drawn(np.zeros(100, dtype=np.int64), 0.5)
    assert one.effective() == pytest.approx(1.0)
    assert one.since_s == 1.0


def test_a_large_family_counts_more_than_small_ones() -> None:
    families = np.array([0] * 90 + list(range(1, 11)))
    assert Genealogy(families, 1.0).effective() == pytest.approx(100**2 / (90**2 + 10))


@pytest.mark.parametrize(("factor", "enough"), [(0.999, False), (1.001, True)])
def test_noise_makes_up_for_lost_families_when_it_has_a_share_of_the_widest_variance(factor, enough) -> None:
    covariance, sigma_v = np.array([[4.0, 1.5], [1.5, 1.0]]), 0.3
    widest = np.linalg.eigvalsh(covariance).max()
    time = np.cbrt(3.0 * REJUVENATION_VARIANCE_SHARE * widest / sigma_v**2)
    assert is_rejuvenated(Genealogy(np.zeros(5, dtype=np.int64), factor * time), covariance, sigma_v) is enough
