"""One trial against its own parts."""

from __future__ import annotations

import math

import numpy as np
import pytest
from sweep_scene import SCENE, trial, without_times

from occlog.errors import InputError, UsageError
from occlog.io.formats.scenes.scene import scene_from_yaml
from occlog.pipeline.sweep.trial import errors_of, rmse_of_priors, run_trial
from occlog.records.tables import Occluders, Tracks, Truth
from occlog.simulate.config import ObserveConfig, WorldConfig
from occlog.simulate.sensors.cameras import observe
from occlog.simulate.stage import simulate_truth
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.methods.apf.config import ApfConfig


def test_a_trial_gives_what_the_stages_give():
    result = run_trial(trial(simulate={"steps": 30, "occluders": 5}, skip=5))
    scene = scene_from_yaml(SCENE, "scene")
    seed = int(np.random.SeedSequence(3, spawn_key=(0,)).generate_state(1, np.uint32)[0])
    truth = Truth.concat(list(simulate_truth(scene, WorldConfig(steps=30, occluders=5), seed)))
    bearings = list(observe(scene, [truth], ObserveConfig(), seed))
    (part,) = track(bearings, scene, TrackingTask(ApfConfig(particles=100), seed))
    own = truth.take(truth.target_id == 0)
    error = np.hypot(part.tracks.x - own.x, part.tracks.y - own.y)[5:]
    assert result["rmse"] == pytest.approx(math.sqrt(np.mean(error**2)), rel=1e-12)
    assert result["estimates"] == 25
    assert result["messages"] == 90
    assert result["bytes"] == 90 * 18
    assert math.isnan(result["rmse_occ"])


def test_the_same_run_is_the_same_world_for_every_setting_and_another_run_is_another():
    a, b = run_trial(trial()), run_trial(trial(priors={"kind": "known"}))
    again, other = run_trial(trial()), run_trial(trial(run=1))
    assert without_times([a]) == without_times([again]) or math.isnan(a["rmse_occ"])
    assert a["rmse"] == again["rmse"]
    assert a["rmse"] != other["rmse"]
    assert b["rmse_occ"] == 0.0
    assert a["rmse"] != b["rmse"]


def test_priors_are_as_good_as_the_virtual_measurements_allow():
    result = run_trial(trial(simulate={"steps": 200, "occluders": 20}, priors={"kind": "kalman", "sigma": 8.0}))
    # RMSE_occ 6.67 in the reference world; 4000 errors that are correlated over some steps
    assert result["rmse_occ"] == pytest.approx(6.67, abs=0.5)


def test_rmse_of_priors_by_hand():
    t = np.array([0, 0], dtype=np.int64)
    truth = Truth(
        t,
        np.array([1, 2], dtype=np.int32),
        np.array(["occluder"] * 2),
        np.array([0.0, 10.0]),
        np.zeros(2),
        np.full(2, np.nan),
    )
    zero = np.zeros(2)
    priors = Occluders(
        t, np.array([1, 2], dtype=np.int32), np.array([3.0, 10.0]), np.array([4.0, 0.0]), zero, zero, zero
    )
    assert rmse_of_priors(priors, truth) == pytest.approx(math.sqrt(12.5))


def test_selection_lowers_the_messages():
    result = run_trial(trial(select={"policy": "greedy", "n_cameras": 1, "selection_interval": 5}))
    assert result["messages"] < 30
    assert result["predicted_mse"] > 0


@pytest.mark.parametrize(
    ("changes", "error", "words"),
    [
        ({"walls": 3}, InputError, "unknown key 'walls'"),
        ({"priors": {"kind": "guess"}}, InputError, "must be one of none, known, kalman"),
        ({"track": {"particle": 3}}, UsageError, "did you mean 'particles'"),
        ({"cameras": ["z"]}, UsageError, "no sensor 'z'"),
        ({"skip": 10}, InputError, "skip fewer"),
    ],
)
def test_what_does_not_fit_is_reported(changes, error, words):
    with pytest.raises(error, match=words):
        run_trial(trial(**changes))


def test_an_estimate_is_lost_when_it_is_more_than_a_fifth_of_the_room_away():
    """The room measures 6 by 8, so that a fifth of its diagonal is 2."""
    scene = scene_from_yaml("occlog_scene: 1\nroom: [[0, 0], [6, 0], [6, 8], [0, 8]]\n", "scene")
    t, none = np.arange(2, dtype=np.int64), np.full(2, np.nan)
    target = np.zeros(2, dtype=np.int32)
    truth = Truth.of(t_ns=t, target_id=target, role=["target"] * 2, x=np.zeros(2), y=np.zeros(2), z=none)
    columns = {c.name: none for c in Tracks.columns()} | {"t_ns": t, "target_id": target, "y": np.zeros(2)}
    for x, lost in ((2.0, 0.0), (2.001, 0.5)):
        positions = {"x": np.array([x, 0.0]), "cov_xx": t + 1.0, "cov_xy": 0.0 * t, "cov_yy": t + 1.0}
        tracks = Tracks.of(**columns | positions)
        assert errors_of(tracks, truth, scene, 0)["lost"] == lost
    assert errors_of(tracks, truth, scene, 1)["estimates"] == 1
    with pytest.raises(InputError, match="skip fewer"):
        errors_of(tracks, truth, scene, 2)
