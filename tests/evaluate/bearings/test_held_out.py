"""Predicting a held-out sensor: residuals by hand, and figures against chance."""

from __future__ import annotations

import math

import numpy as np
import pytest
from bearing_scenes import CASES
from evaluate_scenes import array, both, box, camera, directions, pixels, scene, tracks

from occlog.errors import InputError
from occlog.evaluate.bearings.held_out import CHANCE_SHIFTS, HeldOutFigures
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.matching.paths import paths_of
from occlog.evaluate.stage import evaluate
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Tracks

T5 = [0.0, 1.0, 2.0, 3.0, 4.0]
NAN = math.nan
EAST, NORTH = camera("east", 0, 10, 0), camera("north", 10, 0, 90)
PLACE = scene(EAST, NORTH)


def figures(found: Tracks, bearings: Bearings, made_scene: Scene = PLACE, **options) -> dict[str, float]:
    config = EvaluateConfig(**({"held_out": ("east",)} | options))
    return evaluate(found, None, bearings, made_scene, config).metrics


def test_labelled_rows_by_hand() -> None:
    found = tracks(T5, [[10, 10], [10, 12], [10, 9], [10, 10], [10, 10]])  # predicted u 0 -20 10 0 0
    m = figures(found, pixels(EAST, T5, [3, -24, 10, NAN, -1]))
    residuals = np.array([3, -4, 0, -1])
    assert m["held_out_frames"] == 5
    assert m["held_out_reported"] == 4
    assert m["held_out_rms_px"] == pytest.approx(math.sqrt(np.mean(residuals**2)))
    assert m["held_out_median_px"] == 2.0
    assert m["held_out_p95_px"] == pytest.approx(3 + 0.85)
    assert m["held_out_bias_px"] == pytest.approx(-2 / 4)
    assert m["held_out_share_within"] == 4 / 5  # the frame that reported nothing is not within
    rad = [math.atan(0.03), math.atan(0.24) - math.atan(0.20), 0.0, math.atan(0.01)]
    assert m["held_out_rms_mrad"] == pytest.approx(1e3 * math.sqrt(np.mean(np.square(rad))))
    assert m["held_out_rms_sensor_east_px"] == m["held_out_rms_px"]


def test_nearest_candidate_and_gate() -> None:
    found = tracks(T5[:3], [10, 10])
    candidates = both(
        pixels(EAST, [0.0] * 3, [-60, 2, 40], target=-1),
        pixels(EAST, [1.0] * 2, [30, -7], target=-1),
        pixels(EAST, [2.0], [NAN], target=-1),
    )
    m = figures(found, candidates, held_out_gate=0.05)  # 5 px on the axis
    assert (m["held_out_frames"], m["held_out_reported"]) == (3, 2)
    assert m["held_out_rms_px"] == pytest.approx(math.sqrt((4 + 49) / 2))
    assert m["held_out_rms_within_px"] == 2.0
    assert m["held_out_share_within"] == 1 / 3


def test_only_frames_in_which_the_target_should_be_visible() -> None:
    made_scene = scene(EAST, NORTH, occluders=(box("pillar", 4, 9, 6, 11),))
    # behind the pillar; out of the field of view; behind the camera is outside the room; in view; no estimate near
    found = tracks([0.0, 1.0, 2.0], [[10, 10], [2, 18], [10, 15]])
    m = figures(found, pixels(EAST, [0.0, 1.0, 2.0, 9.0], [0, 0, -50, 0]), made_scene)
    assert m["held_out_frames"] == 1
    assert m["held_out_rms_px"] == pytest.approx(0.0, abs=1e-9)


def test_rows_of_other_targets_are_not_compared() -> None:
    bearings = both(pixels(EAST, T5, [0] * 5, target=0), pixels(EAST, T5, [1] * 5, target=7))
    m = figures(tracks(T5, [10, 10.5]), bearings)
    assert m["held_out_rms_px"] == pytest.approx(5.0)


def test_chance_is_as_good_for_a_target_that_stands_still() -> None:
    t = np.arange(0, 20, 0.5)
    m = figures(tracks(t, [10, 10]), pixels(EAST, t, np.zeros(40)))
    assert m["held_out_share_within"] == m["held_out_share_within_chance"] == 1.0
    assert m["held_out_median_chance_px"] == m["held_out_median_px"] == 0.0


def test_chance_is_worse_for_a_track_that_follows_a_moving_target() -> None:
    rng, t = np.random.default_rng(0), np.arange(0, 100, 0.5)
    y = 10 + 6 * np.sin(t / 7)
    u = -100 * (y - 10) / 10 + rng.normal(size=len(t))
    clutter = [pixels(EAST, t, rng.uniform(-90, 90, len(t)), target=-1) for _ in range(2)]
    m = figures(tracks(t, np.column_stack([np.full(len(t), 10.0), y])), both(pixels(EAST, t, u, target=-1), *clutter))
    assert m["held_out_share_within"] == 1.0
    # Three candidates over 180 px and a gate of 5 px (10 near the edge): about 1 - (1 - 10/180)^3
    assert 0.1 < m["held_out_share_within_chance"] < 0.35
    assert m["held_out_median_px"] < 1.0 < 10.0 < m["held_out_median_chance_px"]


def test_track_of_something_else_is_no_better_than_chance() -> None:
    rng, t = np.random.default_rng(1), np.arange(0, 200, 0.5)
    y = 10 + 6 * np.sin(t / 7)
    candidates = [pixels(EAST, t, rng.uniform(-90, 90, len(t)), target=-1) for _ in range(3)]
    m = figures(tracks(t, np.column_stack([np.full(len(t), 10.0), y])), both(*candidates))
    share, chance = m["held_out_share_within"], m["held_out_share_within_chance"]
    assert abs(share - chance) < 4 * math.sqrt(chance * (1 - chance) / len(t))


def test_two_held_out_sensors_are_added_up() -> None:
    bearings = both(pixels(EAST, T5, [1] * 5), pixels(NORTH, T5[:1], [7]))
    m = figures(tracks(T5, [10, 10]), bearings, held_out=("east", "north"))
    assert m["held_out_rms_sensor_east_px"] == pytest.approx(1.0)
    assert m["held_out_rms_sensor_north_px"] == pytest.approx(7.0)
    assert m["held_out_rms_px"] == pytest.approx(math.sqrt((5 * 1 + 49) / 6))


def test_array_has_angles_only_and_they_wrap() -> None:
    made_scene = scene(EAST, arrays=(array("ear", 15.0, 10.0),))
    m = figures(
        tracks(T5, [5, 10.01]), directions("ear", T5, [-math.pi + 0.01] * 5, 0.02), made_scene, held_out=("ear",)
    )
    assert m["held_out_rms_mrad"] == pytest.approx(11.0, rel=1e-4)
    assert math.isnan(m["held_out_rms_px"])


def test_names_that_are_not_there() -> None:
    found, bearings = tracks(T5, [10, 10]), pixels(NORTH, T5, [0] * 5)
    with pytest.raises(InputError, match="held out: sensor 'cam9'"):
        figures(found, bearings, held_out=("cam9",))
    with pytest.raises(InputError, match="no row of the held-out sensor 'east'"):
        figures(found, bearings)
    with pytest.raises(InputError, match="needs tracks made without it"):
        evaluate(None, None, bearings, PLACE, EvaluateConfig(held_out=("north",)))


@pytest.mark.parametrize("what", CASES)
def test_figures_do_not_depend_on_blocks_and_memory(what: str) -> None:
    case, names = CASES[what](7), ("c",) if what == "in space" else ("a", "c")
    config, tracks = EvaluateConfig(held_out=names, held_out_gate=0.02), paths_of(case.tracks)
    found, whole = (
        HeldOutFigures(case.place, list(tracks), config, 7, 100),
        HeldOutFigures(case.place, list(tracks), config),
    )
    for each in (found, whole):
        each.update(case.bearings, tracks)
    assert found.result() == pytest.approx(whole.result(), rel=1e-9, nan_ok=True)
    assert whole.result()["held_out_frames"] > 20


def test_chance_by_the_definition() -> None:
    """Frame n + s against the prediction n, for each shift s, by plain loops."""
    random = np.random.default_rng(3)
    times, place = np.arange(40) * 0.5, scene(EAST, NORTH)
    found = tracks(times, np.column_stack([np.full(40, 10.0), 10 + random.normal(0, 2, 40)]))
    u = random.normal(0, 20, 40)
    u[::7] = NAN
    m = figures(found, pixels(EAST, times, u), place)
    predicted = -100.0 * (found.y - 10.0) / 10.0
    shifts = np.unique(np.rint(np.linspace(0.1, 0.9, CHANCE_SHIFTS) * 40).astype(int))
    off = [abs(u[(n + s) % 40] - predicted[n]) for s in shifts for n in range(40)]
    assert m["held_out_median_chance_px"] == pytest.approx(np.nanmedian(off))
    turned = [abs(math.atan(u[(n + s) % 40] / 100) - math.atan(predicted[n] / 100)) for s in shifts for n in range(40)]
    within = np.count_nonzero(np.array(turned) <= EvaluateConfig().held_out_gate)
    assert m["held_out_share_within_chance"] == pytest.approx(within / len(turned))
