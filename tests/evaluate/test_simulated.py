"""What evaluate says of simulated bearings whose losses and noise are known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from evaluate_scenes import box, camera, scene, tracks

from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.stage import evaluate
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Truth
from occlog.simulate.config import ObserveConfig, WorldConfig
from occlog.simulate.sensors.cameras import observe
from occlog.simulate.stage import simulate_truth

NOISE = {"sigma_position": 0.1, "sigma_yaw": 0.01, "sigma_read_px": 1.5}
PLACE = scene(
    camera("east", 0, 10, 0, **NOISE),
    camera("north", 10, 0, 90, **NOISE),
    camera("corner", 20, 20, 225, **NOISE),
    occluders=(box("pillar", 8, 8, 11, 11),),
    unit="unit",
)


def world(steps: int, occluders: int, seed: int, made_scene: Scene = PLACE) -> Truth:
    config = WorldConfig(steps=steps, targets=1, occluders=occluders, diameter=1.0)
    return Truth.concat(simulate_truth(made_scene, config, seed))


def seen(truth: Truth, seed: int, made_scene: Scene = PLACE, **options: float) -> Bearings:
    return Bearings.concat(observe(made_scene, [truth], ObserveConfig(diameter=1.0, **options), seed))


@pytest.mark.parametrize("occluders", [0, 6])
def test_visibility_noise_and_detections_agree_with_the_simulation(occluders: int) -> None:
    truth = world(1500, occluders, 3)
    m = evaluate(None, truth, seen(truth, 3), PLACE, EvaluateConfig(occluder_diameter=1.0, gate_sigma=8.0)).metrics
    assert m["missed"] == m["false_alarms"] == m["detected_hidden"] == 0
    assert m["detection_rate"] == 1.0
    assert 1500 < m["visible"] < 3 * 1500
    # Mean of squares of n standard normal residuals: 1 +- sqrt(2 / n)
    assert abs(m["bearing_nis"] - 1.0) < 4 * math.sqrt(2 / m["detected"])
    assert abs(m["bearing_bias_px"]) < 4 * m["bearing_rms_px"] / math.sqrt(m["detected"])


def test_misses_and_false_alarms_come_back_as_rates() -> None:
    truth = world(2000, 0, 5)
    m = evaluate(
        None,
        truth,
        seen(truth, 5, miss_probability=0.1, false_alarm_probability=0.2),
        PLACE,
        EvaluateConfig(gate_px=8.0),
    ).metrics
    n = m["visible"]
    # Some false alarms fall into the gate by chance, and the gate cuts a little noise: 2 % each
    assert abs(m["detection_rate"] - 0.9) < 0.02 + 4 * math.sqrt(0.09 / n)
    unseen = m["detection_opportunities"] - m["detected"]
    assert abs(m["false_alarms"] / unseen - 0.2) < 0.03 + 4 * math.sqrt(0.16 / unseen)


def test_unlabelled_bearings_are_distinguished_from_clutter() -> None:
    truth = world(600, 3, 7)
    labelled = seen(truth, 7)
    columns = {c.name: getattr(labelled, c.name) for c in Bearings.columns()}
    unlabelled = Bearings(**{**columns, "target_id": np.full(len(labelled), -1, dtype=np.int32)})
    config = EvaluateConfig(occluder_diameter=1.0)
    with_labels = evaluate(None, truth, labelled, PLACE, config)
    without = evaluate(None, truth, unlabelled, PLACE, config)
    assert without.metrics["visible"] == with_labels.metrics["visible"]
    assert without.metrics["false_alarms"] <= with_labels.metrics["false_alarms"] + 2
    # Only the target is reported, so a candidate nearer to an occluder is taken for that one's: it costs some
    assert with_labels.metrics["detection_rate"] > without.metrics["detection_rate"] > 0.8
    np.testing.assert_array_less(with_labels.bound.bound - 1e-9, without.bound.bound)


@pytest.mark.jit
@pytest.mark.parametrize("seed", [1, 2])
def test_errors_drawn_from_the_bound_have_the_ratio_one_and_are_consistent(seed: int) -> None:
    truth = world(2000, 0, seed)
    bearings = seen(truth, seed)
    bound = evaluate(None, truth, bearings, PLACE, EvaluateConfig()).bound
    P = np.empty((len(bound), 2, 2))
    P[:, 0, 0], P[:, 1, 1] = bound.bound_xx, bound.bound_yy
    P[:, 0, 1] = P[:, 1, 0] = bound.bound_xy
    draws = np.random.default_rng(seed).normal(size=(len(bound), 2, 1))
    xy = np.column_stack([truth.x, truth.y]) + (np.linalg.cholesky(P) @ draws)[:, :, 0]
    made = tracks(np.arange(len(bound)), xy)
    ideal = type(made).of(
        t_ns=truth.t_ns,
        target_id=made.target_id,
        x=made.x,
        y=made.y,
        vx=made.vx,
        vy=made.vy,
        cov_xx=bound.bound_xx,
        cov_xy=bound.bound_xy,
        cov_yy=bound.bound_yy,
    )
    m = evaluate(ideal, truth, bearings, PLACE).metrics
    # The squared errors are dominated by the times in the pillar's shadow: about 5 % error of the ratio
    assert abs(m["bound_ratio"] - 1.0) < 0.1
    assert abs(m["nees_mean"] - 2.0) < 4 * 2 / math.sqrt(len(bound))
    assert abs(m["nees_share_95"] - 0.95) < 4 * math.sqrt(0.95 * 0.05 / len(bound))
