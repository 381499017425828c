"""A filter that has lost its target finds it again: a short form of `benchmarks/track/recovery.py`."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tracker_scenes import room100

from occlog.records.tables import Bearings, Truth
from occlog.scans.grouping import BearingRows, scans_of
from occlog.simulate.config import ObserveConfig, WorldConfig
from occlog.simulate.sensors.cameras import observe
from occlog.simulate.stage import simulate_truth
from occlog.track.methods.apf import filter as apf
from occlog.track.methods.apf.config import ApfConfig

RUNS = 12
HIDDEN = 60
FOUND = 5.0
WITHIN = 20


def recorded(scene, seed):
    """Scans of the target among 40 people who hide it, and its true places."""
    truth = Truth.concat(simulate_truth(scene, WorldConfig(steps=130, occluders=40), seed))
    bearings = Bearings.concat(observe(scene, [truth], ObserveConfig(), seed))
    own = truth.target_id == 0
    scans = [g.of_target(0) for g in scans_of([bearings], scene, BearingRows({c.name for c in scene.cameras}))]
    return scans, np.column_stack([truth.x[own], truth.y[own]])


def unseen(scan):
    nothing = np.full(len(scan.sensor), np.nan)
    return scan._replace(
        seen=np.zeros(len(scan.sensor), dtype=bool), bearing=nothing, sigma=nothing, u_px=nothing, sigma_px=nothing
    )


def steps_until_found(state, scans, xy, rng):
    """Scans from the first seen by two cameras on; None if two never see it."""
    steps = 0
    for scan, place in zip(scans, xy, strict=True):
        state, estimate = apf.step(state, scan, rng)
        steps += bool(steps or np.count_nonzero(scan.seen) >= 2)
        if steps and math.dist(estimate.xy, place) < FOUND:
            return steps
    return math.inf if steps else None


@pytest.mark.jit
@pytest.mark.parametrize("how", [pytest.param("started wrong", marks=pytest.mark.statistics), "hidden for long"])
def test_a_lost_target_is_found_within_20_steps_of_being_seen_by_two_cameras(how):
    """12 runs, all of them: with 95 in 100 that is likely (54 %), with 70 in 100 it is not (1.4 %).

    The benchmark has 100 runs, and finds the target in each.
    """
    scene, taken = room100(cameras=4), []
    for seed in range(RUNS):
        scans, xy = recorded(scene, seed)
        rng, first, start = np.random.default_rng(seed), 0, None
        if how == "started wrong":
            start = (*np.where(xy[0] > 50.0, 10.0, 90.0).tolist(), 2.0)
        state = apf.init(scene, ApfConfig(particles=500, start=start), rng)
        if how == "hidden for long":
            first = 10 + HIDDEN
            for k in range(first):
                state, _ = apf.step(state, scans[k] if k < 10 else unseen(scans[k]), rng)
        taken.append(steps_until_found(state, scans[first:], xy[first:], rng))
    judged = [steps for steps in taken if steps is not None]
    assert len(judged) >= RUNS - 2
    assert sum(steps <= WITHIN for steps in judged) == len(judged)


@pytest.mark.jit
def test_a_single_false_report_does_not_throw_particles_away():
    scene = room100(cameras=4)
    scans, _ = recorded(scene, 0)
    rng = np.random.default_rng(0)
    state = apf.init(scene, ApfConfig(particles=500), rng)
    fallbacks = []
    for k, scan in enumerate(scans[:40]):
        if k % 8 == 7 and scan.seen.any():
            row = int(np.flatnonzero(scan.seen)[0])
            u = scan.u_px.copy()
            u[row] = -u[row] + 40.0 * np.sign(-u[row])
            scan = scan._replace(u_px=u)
        state, estimate = apf.step(state, scan, rng)
        fallbacks.append(estimate.fallback)
    assert "restart" not in fallbacks[10:]
