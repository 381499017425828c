"""The fit of path losses, shadowing and range, on data with known parameters."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from occlog.track.methods.readers.fit.estimate import TagWindows, choose_range, fit_losses, fit_shadowing, usual_ranges
from occlog.track.methods.readers.rssi import PathLoss

PLACES = np.array([[x, y, 1.0] for x in (0.0, 4.0) for y in (0.0, 4.0)])


def test_least_squares_finds_powers_and_exponent() -> None:
    rng = np.random.default_rng(4)
    reader, distance = rng.integers(0, 3, 4000), rng.uniform(0.5, 20.0, 4000)
    power = np.array([-55.0, -60.0, -65.0])
    rssi = power[reader] - 17.0 * np.log10(distance) + 4.0 * rng.standard_normal(4000)
    found = fit_losses(reader, distance, rssi, 4)
    assert_allclose(found.power[:3], power, atol=5.0 * found.error[:3].max())
    assert_allclose(found.exponent, 1.7, atol=5.0 * found.exponent_error)
    assert_allclose(found.residual_db, 4.0, rtol=0.05)
    # The fourth has no reads: the mean of the others
    assert_allclose(found.power[3], found.power[:3].mean())
    assert np.isnan(found.error[3])


def test_strengths_that_rise_with_distance_are_refused() -> None:
    distance = np.linspace(1.0, 10.0, 50)
    with pytest.raises(ValueError, match="do not fall"):
        fit_losses(np.zeros(50, dtype=np.int64), distance, -80.0 + distance, 1)


def test_few_reads_are_refused() -> None:
    distance = np.array([1.0, 2.0, 3.0, 4.0])
    fit_losses(np.zeros(4, dtype=np.int64), distance, -60.0 - 20.0 * np.log10(distance), 1)
    with pytest.raises(ValueError, match="too few"):
        fit_losses(np.zeros(3, dtype=np.int64), distance[:3], -60.0 - 20.0 * np.log10(distance[:3]), 1)


def test_likelihood_tells_shadowing_from_noise() -> None:
    rng = np.random.default_rng(5)
    model = PathLoss(PLACES, np.full(4, -60.0), 2.0, 5.0, 3.0, 5.0, 1.0, 1.0)
    n, true = 400, {"noise": 4.0, "shadow": 6.0, "forget": 8.0}
    shadow, decay = true["shadow"] * rng.standard_normal(4), np.exp(-1.0 / true["forget"])
    xy, rssi = rng.uniform(0.0, 4.0, (n, 2)), np.zeros((n, 4))
    for k in range(n):
        shadow = decay * shadow + true["shadow"] * np.sqrt(1.0 - decay**2) * rng.standard_normal(4)
        rssi[k] = model.expected(xy[k : k + 1])[0] + shadow + true["noise"] * rng.standard_normal(4)
    segment = TagWindows(np.arange(n, dtype=np.float64), xy, np.ones((n, 4), dtype=np.int64), rssi)
    found = fit_shadowing(model, [segment])
    assert_allclose(found.noise_db, true["noise"], rtol=0.1)
    assert_allclose(found.shadow_db, true["shadow"], rtol=0.2)
    assert_allclose(found.shadow_s, true["forget"], rtol=0.5)


def test_the_range_with_the_least_error_is_chosen() -> None:
    rng = np.random.default_rng(6)
    model = PathLoss(PLACES, np.full(4, -60.0), 2.0, 1e-3, 1e-3, 5.0, 1.0, 1.0)
    xy = rng.uniform(0.0, 4.0, (500, 2))
    segment = TagWindows(np.arange(500.0), xy, np.ones((500, 4), dtype=np.int64), model.expected(xy))
    room = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])
    found = choose_range(model, [segment], [0.5, 2.7, 40.0], room)
    assert found.range == 2.7
    assert found.detection > 0.99
    assert found.stray < 0.01


def test_usual_ranges_are_about_the_distance_of_neighbours() -> None:
    found = usual_ranges(PLACES[:, :2])
    assert_allclose([found[0], found[-1]], [2.0, 8.0])
    with pytest.raises(ValueError, match="one reader alone"):
        usual_ranges(PLACES[:1, :2])
    with pytest.raises(ValueError, match="one position"):
        usual_ranges(np.zeros((2, 2)))
