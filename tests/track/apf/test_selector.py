"""Selection of cameras while tracking: what is used, what is written, what it saves."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from tracker_scenes import SECOND, observe, room100, walk

from occlog.records.tables import Bearings, Diagnostics, Tracks
from occlog.track.drivers.rows import NetworkTraffic
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.methods.apf.config import ApfConfig, SelectConfig

pytestmark = pytest.mark.jit
SCENE = room100(pillar=False)
CONFIG = ApfConfig(particles=200, initial_particle_factor=2)
STEPS = 20


def recording(seed=0):
    rng = np.random.default_rng(seed)
    return observe(SCENE, walk(STEPS, rng), rng)


def asynchronous(seed=0):
    """Cameras 1 to 4 at full seconds, 5 to 8 half a second later and every other second only."""
    table = recording(seed)
    number = np.char.replace(table.sensor, "cam", "").astype(int)
    late = number > 4
    keep = ~late | (table.t_ns // SECOND % 2 == 0)
    shifted = replace(table, t_ns=np.where(late, table.t_ns + SECOND // 2, table.t_ns))
    return Bearings.merge([shifted.take(keep)])


def whole(bearings, selection, **options):
    parts = list(track([bearings], SCENE, TrackingTask(CONFIG, 3, selection=selection, **options)))
    return Tracks.concat(p.tracks for p in parts), Diagnostics.concat(p.diagnostics for p in parts)


def counted(diagnostics):
    messages = NetworkTraffic()
    for k in range(len(diagnostics)):
        messages.add(diagnostics.take(slice(k, k + 1)))
    together = NetworkTraffic()
    together.add(diagnostics)
    assert messages.summary() == together.summary()
    return messages


def test_only_selected_cameras_are_used_and_written():
    _, d = whole(recording(), SelectConfig("greedy", 3, selection_interval=4, max_blind_scans=0))
    assert len(d) == STEPS
    for row in range(STEPS):
        assert len(d.selected[row].split(",")) == 3
        assert set(d.cameras[row].split(",")) == set(d.selected[row].split(","))
    np.testing.assert_array_equal(d.n_observing, 3)
    np.testing.assert_array_equal(d.n_available, 8)
    made = np.flatnonzero(np.isfinite(d.predicted_mse))
    np.testing.assert_array_equal(made, np.arange(0, STEPS, 4))
    changes = np.flatnonzero(d.selected[1:] != d.selected[:-1]) + 1
    assert set(changes.tolist()) <= set(made.tolist())
    assert np.all(d.predicted_mse[made] > 0)


def test_steps_between_selections_are_reference_steps():
    config = ApfConfig(particles=200, initial_particle_factor=2, reference_step_s=2.0)
    parts = track(
        [recording()], SCENE, TrackingTask(config, 3, selection=SelectConfig("closest", 2, selection_interval=2.5))
    )
    d = Diagnostics.concat(p.diagnostics for p in parts)
    np.testing.assert_array_equal(np.flatnonzero(np.isfinite(d.predicted_mse)), np.arange(0, STEPS, 5))


def test_messages_and_bytes_of_fixed_cameras_by_hand():
    _, d = whole(recording(), SelectConfig("fixed", 3, selection_interval=5))
    # 20 scans of 3 cameras; 3 are switched on once; all 8 would have sent 160.
    assert counted(d).summary() == {
        "messages": 63,
        "bytes": 60 * 18 + 3 * 4,
        "selections": 4,
        "bytes_all_cameras": 160 * 18,
        "share_saved": 1 - (60 * 18 + 12) / (160 * 18),
    }


def test_messages_of_changing_cameras_by_hand():
    _, d = whole(recording(), SelectConfig("random", 2, selection_interval=5))
    sets = [set(d.selected[k].split(",")) for k in range(0, STEPS, 5)]
    orders = 2 + sum(len(a ^ b) for a, b in pairwise(sets))
    assert orders > 2
    found = counted(d)
    assert (found.reports, found.orders, found.selections) == (40, orders, 4)


def test_cameras_at_their_own_times():
    """Frames of cameras that were not asked count as offered in the next row."""
    table = asynchronous()
    _, d = whole(table, SelectConfig("fixed", 2, selection_interval=1000))  # cam1 and cam2: full seconds only
    assert len(d) == STEPS
    np.testing.assert_array_equal(d.t_ns, np.arange(STEPS) * SECOND)
    np.testing.assert_array_equal(d.n_observing, 2)
    # After every even second four more cameras deliver, before the row of the next odd second.
    np.testing.assert_array_equal(d.n_available, [4, *[8, 4] * 9, 8])
    found = counted(d)
    assert (found.reports, found.orders, found.offered) == (2 * STEPS, 2, len(table))


def test_cameras_at_their_own_times_with_changes():
    table = asynchronous(1)
    _, d = whole(table, SelectConfig("greedy", 4, selection_interval=3, max_blind_scans=0))
    delivered = [len(table.t_ns[table.t_ns == t]) for t in np.unique(table.t_ns)]
    assert d.n_available.sum() == len(table) - sum(
        n for n, t in zip(delivered, np.unique(table.t_ns), strict=True) if t > d.t_ns[-1]
    )
    for row in range(len(d)):
        assert set(d.cameras[row].split(",")) <= set(d.selected[row].split(","))
        assert d.n_observing[row] == len(d.cameras[row].split(","))
        there = set(table.sensor[table.t_ns == d.t_ns[row]].tolist())
        assert set(d.cameras[row].split(",")) == there & set(d.selected[row].split(","))


def test_all_cameras_give_the_track_without_selection():
    table = recording(2)
    selected, _ = whole(table, SelectConfig("all"))
    plain, d = whole(table, None)
    for column in Tracks.columns():
        np.testing.assert_array_equal(getattr(selected, column.name), getattr(plain, column.name))
    assert set(d.selected.tolist()) == {""}
    assert np.all(np.isnan(d.predicted_mse))
    assert counted(d).reports == 160
    assert counted(d).summary() == {}


def test_the_same_seed_selects_the_same():
    a, b = (whole(recording(), SelectConfig("random", 2, selection_interval=1))[1] for _ in range(2))
    np.testing.assert_array_equal(a.selected, b.selected)
    parts = track(
        [recording()], SCENE, TrackingTask(CONFIG, 4, selection=SelectConfig("random", 2, selection_interval=1))
    )
    assert np.any(Diagnostics.concat(p.diagnostics for p in parts).selected != a.selected)


def test_left_out_cameras_are_not_selected():
    usable = frozenset({"cam1", "cam4", "cam6"})
    _, d = whole(recording(), SelectConfig("greedy", 2, selection_interval=1, max_blind_scans=0), sensors=usable)
    assert set(",".join(d.selected).split(",")) <= usable
    np.testing.assert_array_equal(d.n_available, 3)


def one_target(seen_by_cameras, steps=STEPS):
    """Exact bearings of a target that stands, labelled, of the cameras that see it in each step; the others look."""
    table = recording(5)
    table = table.take(table.t_ns < steps * SECOND)
    number = np.char.replace(table.sensor, "cam", "").astype(int)
    wanted = np.array([n in seen_by_cameras(int(t // SECOND)) for n, t in zip(number, table.t_ns, strict=True)])
    keep = wanted & table.seen
    nothing = np.where(keep, 0.0, np.nan)
    columns = {name: getattr(table, name) + nothing for name in ("bearing", "sigma", "u_px", "sigma_px", "score")}
    return replace(table, seen=keep, **columns)


def names(text):
    return {int(name.removeprefix("cam")) for name in text.split(",") if name}


def test_all_cameras_are_asked_until_two_have_seen_the_target_at_once():
    table = one_target(lambda step: {1} if step < 3 else range(1, 9))
    _, d = whole(table, SelectConfig("greedy", 3, selection_interval=5))
    assert d.selected[:4].tolist() == [""] * 4
    np.testing.assert_array_equal(d.n_observing[:4], 8)
    np.testing.assert_array_equal(d.n_observing[4:], 3)


def test_cameras_that_lose_sight_are_replaced_in_the_next_scan_and_not_asked_again_soon():
    _, before = whole(one_target(lambda step: range(1, 9)), SelectConfig("greedy", 3, selection_interval=100))
    chosen = names(before.selected[1])
    blind = one_target(lambda step: set(range(1, 9)) - (chosen if step >= 3 else set()))
    _, d = whole(blind, SelectConfig("greedy", 3, selection_interval=100))
    first = names(d.selected[1])
    _, patient = whole(blind, SelectConfig("greedy", 3, selection_interval=100, max_blind_scans=0))
    assert len(set(patient.selected.tolist())) == 1
    lost = [k for k in range(1, STEPS) if k >= 3 and d.n_detected[k] < 2]
    assert all(names(d.selected[k]) != names(d.selected[k + 1]) for k in lost if k + 1 < STEPS)
    assert names(d.selected[-1]) != first


def test_patience_counts_scans_in_a_row():
    blind = one_target(lambda step: range(1, 9) if step < 2 else set())
    for patience in (1, 3):
        _, d = whole(blind, SelectConfig("greedy", 3, selection_interval=100, max_blind_scans=patience), window_ns=0)
        made = np.flatnonzero(np.isfinite(d.predicted_mse))
        assert made[0] == 1
        assert made[1] == 2 + patience


def test_baselines_select_without_regard_to_what_was_seen():
    blind = one_target(lambda step: range(1, 9) if step < 2 else set())
    _, d = whole(blind, SelectConfig("closest", 3, selection_interval=7, max_blind_scans=1))
    np.testing.assert_array_equal(np.flatnonzero(np.isfinite(d.predicted_mse)), [0, 7, 14])
