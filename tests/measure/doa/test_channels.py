"""What is checked of sound: each check on clean samples, and on samples with the fault that it is for."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from occlog.measure.doa.channels import Channels, checks
from occlog.measure.doa.stage import DoaTally


def found(samples: NDArray[np.float64], rows: int = 1) -> set[str]:
    """Ids of what is found, in blocks of uneven size."""
    channels = Channels()
    for _ in channels.watch(np.array_split(samples, 7)):
        pass
    made = checks({"mic": channels}, {"mic": DoaTally(10, 4, 6)}, {"mic": rows})
    assert all(check.sensors == ("mic",) for check in made if check.found)
    return {check.id for check in made if check.found}


def sound(seed: int) -> NDArray[np.float64]:
    """(n, 4) samples of a talker with pauses, gains within 6 dB, and each microphone's own noise."""
    rng = np.random.default_rng(seed)
    talk = rng.standard_normal(16000) * (np.sin(np.arange(16000) / 1500.0) > 0.3)
    gains = 10.0 ** (rng.uniform(-6.0, 6.0, 4) / 20.0)
    return 0.1 * gains * (talk[:, None] + 0.02 * rng.standard_normal((16000, 4)))


@pytest.mark.parametrize("seed", range(10))
def test_nothing_is_found_in_clean_sound(seed: int) -> None:
    assert found(np.clip(sound(seed), -1.0, 1.0)) == set()


@pytest.mark.parametrize("seed", range(3))
def test_each_fault_is_found(seed: int) -> None:
    clean = sound(seed)
    dead = clean.copy()
    dead[:, 2] = 1e-4 * np.random.default_rng(seed).standard_normal(len(dead))
    assert found(dead) == {"microphone-silent"}
    dead[:, 2] = 0.0
    assert found(dead) == {"microphone-silent"}
    alike = clean.copy()
    alike[:, 3] = alike[:, 0]
    assert found(alike) == {"microphones-identical"}
    assert found(np.clip(8.0 * clean, -1.0, 1.0)) == {"clipped"}
    assert found(clean, rows=0) == {"no-directions"}
