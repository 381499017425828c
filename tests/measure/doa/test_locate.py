"""Bands, grids and peaks of the map of an array, at their limits; a made-up map stands for the algorithm's."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.errors import UsageError
from occlog.measure.doa.config import DoaConfig
from occlog.measure.doa.locate import MAX_SOURCES, DirectionGrid, make_band, make_grid, peaks, refined
from occlog.records.scene import MicrophoneArray

RATE, C = 16000, 343.0
SQUARE = 0.04 * np.array([[1.0, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]])
SOLID = 0.06 * np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
STEP = 10.0


def flat_grid() -> DirectionGrid:
    azimuth = np.radians(np.arange(-180.0, 180.0, STEP))
    return DirectionGrid(azimuth, np.zeros(1), np.ones((1, len(azimuth)), dtype=np.bool_))


def chart(**heights: float) -> np.ndarray:
    """A map that is 0 but for peaks at some columns, `c3=1.0`; its median is 0."""
    out = np.zeros((1, len(flat_grid().azimuth)))
    for name, height in heights.items():
        out[0, int(name[1:])] = height
    return out


def found(heights: np.ndarray, **options: float) -> list[int]:
    """Columns of the peaks."""
    config = DoaConfig(**{"max_sources": 0, "min_peak": 0.6, **options})  # type: ignore[arg-type]
    return [column for _, column in peaks(heights, flat_grid(), config)]


def test_a_band_wants_three_frequencies() -> None:
    """Windows of 0.04 s at 16 kHz are 1024 samples: a bin each 15.625 Hz."""
    assert len(make_band(RATE, DoaConfig(low_hz=312.5, high_hz=343.75)).bins) == 3
    with pytest.raises(UsageError, match="has 2 frequencies of a recording at 16000 Hz"):
        make_band(RATE, DoaConfig(low_hz=312.6, high_hz=343.75))


def test_a_window_is_at_least_as_long_as_asked_and_a_power_of_two() -> None:
    exact = DoaConfig(window_s=1024 / RATE)
    assert make_band(RATE, exact).length == 1024
    assert make_band(RATE, DoaConfig(window_s=1025 / RATE)).length == 2048


def test_a_grid_goes_all_around_and_a_flat_array_has_the_half_above() -> None:
    band = make_band(RATE, DoaConfig())
    config = DoaConfig(grid_deg=10.0)
    level = make_grid(MicrophoneArray("m", np.zeros(3), microphones=SQUARE, planar=True), band, C, config)
    assert level.allowed.shape == (1, 36)
    solid = make_grid(MicrophoneArray("m", np.zeros(3), microphones=SOLID), band, C, config)
    assert solid.allowed.all()
    assert solid.elevation.min() == -solid.elevation.max()
    flat = make_grid(MicrophoneArray("m", np.zeros(3), microphones=SQUARE), band, C, config)
    assert (flat.elevation[flat.allowed.any(axis=1)] >= 0.0).all()


def test_a_grid_with_too_many_directions_is_refused() -> None:
    array = MicrophoneArray("m", np.zeros(3), microphones=SOLID)
    band = make_band(RATE, DoaConfig())
    with pytest.raises(UsageError) as raised:
        make_grid(array, band, C, DoaConfig(grid_deg=0.4))
    assert raised.value.id == "problem-too-large"


def test_peaks_come_by_falling_height_and_lower_ones_than_the_share_are_none() -> None:
    assert found(chart(c3=0.8, c12=1.0, c24=0.6)) == [12, 3, 24]
    assert found(chart(c3=0.8, c12=1.0, c24=0.599)) == [12, 3]


def test_peaks_nearer_than_the_angle_apart_are_one() -> None:
    two = chart(c10=1.0, c12=0.9)
    assert found(two, min_separation_deg=2 * STEP - 0.1) == [10, 12]
    assert found(two, min_separation_deg=2 * STEP + 0.1) == [10]
    around = chart(c0=1.0, c34=0.9)  # 20 degrees apart across the turn
    assert found(around, min_separation_deg=2 * STEP + 0.1) == [0]


def test_as_many_peaks_are_given_as_are_asked_for() -> None:
    many = chart(**{f"c{k}": 1.0 - 0.01 * k for k in range(0, 36, 3)})
    assert found(many, max_sources=2) == [0, 3]
    assert len(found(many)) == MAX_SOURCES


def test_directions_that_are_not_allowed_are_no_peaks() -> None:
    grid = flat_grid()
    grid.allowed[0, 12] = False
    config = DoaConfig(max_sources=0)
    assert peaks(chart(c3=0.8, c12=1.0), grid, config) == [(0, 3)]


def test_the_top_of_a_parabola_is_found_between_directions_and_across_the_turn() -> None:
    grid = flat_grid()
    for top in (-5.0, 0.0, 4.0):
        at = np.degrees(grid.azimuth)
        away = (at - (170.0 + top) + 180.0) % 360.0 - 180.0
        heights = -(away**2)[None]
        column = int(np.argmax(heights[0]))
        azimuth, elevation = refined(heights, grid, 0, column)
        assert (np.degrees(azimuth) - (170.0 + top) + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=1e-9)
        assert elevation == 0.0
