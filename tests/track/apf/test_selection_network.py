"""Selection in networks of cameras with rates of their own, of several targets, with microphone arrays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tracker_scenes import PLACES, SECOND, observe, room100, walk, with_array

from occlog.core.occlusion.priors import gaussian_priors
from occlog.records.tables import Bearings, Diagnostics, Occluders, Tracks
from occlog.track.drivers.rows import NetworkTraffic
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.interface import ParticleSet
from occlog.track.methods.apf import selector as stage
from occlog.track.methods.apf.config import ApfConfig, SelectConfig
from occlog.track.methods.apf.filter import METHOD
from occlog.track.methods.apf.selector import choose, network

pytestmark = pytest.mark.jit
SCENE = room100(pillar=False)
CONFIG = ApfConfig(particles=200, initial_particle_factor=2)
STEPS = 20


def recording(seed=0, target=0, steps=STEPS):
    rng = np.random.default_rng([seed, target])
    path = walk(steps, rng)
    return path, observe(SCENE, path, rng, target=target)


def asynchronous(seed=0):
    """Cameras 1 to 4 at full seconds, 5 to 8 half a second after every even one."""
    table = recording(seed)[1]
    late = np.isin(table.sensor, ["cam5", "cam6", "cam7", "cam8"])
    keep = ~late | (table.t_ns // SECOND % 2 == 0)
    shifted = replace(table, t_ns=np.where(late, table.t_ns + SECOND // 2, table.t_ns))
    return Bearings.merge([shifted.take(keep)])


def of_array(steps=STEPS):
    n = steps
    return Bearings.of(
        t_ns=np.arange(n) * SECOND,
        sensor=["array"] * n,
        target_id=np.zeros(n, dtype=np.int32),
        seen=np.full(n, False),
        bearing=np.full(n, np.nan),
        sigma=np.full(n, np.nan),
        u_px=np.full(n, np.nan),
        sigma_px=np.full(n, np.nan),
        score=np.full(n, np.nan),
    )


def whole(bearings, selection, *, scene=SCENE, seed=3, config=CONFIG, occluders=None, **options):
    parts = list(track([bearings], scene, TrackingTask(config, seed, selection=selection, **options), occluders))
    return Tracks.concat(p.tracks for p in parts), Diagnostics.concat(p.diagnostics for p in parts)


def counted(diagnostics):
    messages = NetworkTraffic()
    messages.add(diagnostics)
    return messages


def test_bytes_of_cameras_at_their_own_times_by_hand():
    """cam1 sends 20 frames, cam5 10; all would send 4 x 20 + 4 x 10; two orders."""
    _, d = whole(asynchronous(), SelectConfig("fixed", 2, selection_interval=4, camera_order=("cam5", "cam1")))
    assert len(d) == 30
    np.testing.assert_array_equal(d.n_available, 4)
    np.testing.assert_array_equal(d.cameras, np.where(d.t_ns % SECOND == 0, "cam1", "cam5"))
    assert counted(d).summary() == {
        "messages": 32,
        "bytes": 30 * 18 + 2 * 4,
        "selections": 5,
        "bytes_all_cameras": 120 * 18,
        "share_saved": 1 - 548 / 2160,
    }


def test_steps_are_counted_in_time_from_the_last_selection():
    """Scans at 0, 0.5, 1, 2, 2.5, 3, ...: after 1.2 s the next scan is at 2 s or 4 s; after 1.6 s the same."""
    for every, want in ((1.2, 2.0), (1.6, 2.0), (0.5, None)):
        _, d = whole(asynchronous(), SelectConfig("all", selection_interval=every))
        made = d.t_ns[np.isfinite(d.predicted_mse)] / SECOND
        np.testing.assert_array_equal(made, d.t_ns / SECOND if want is None else np.arange(0, STEPS, want))


def test_a_very_long_time_means_once():
    _, d = whole(asynchronous(), SelectConfig("random", 3, selection_interval=1e12))
    np.testing.assert_array_equal(np.flatnonzero(np.isfinite(d.predicted_mse)), [0])
    assert len(set(d.selected.tolist())) == 1


@pytest.mark.parametrize("policy", ["greedy", "random", "closest"])
@pytest.mark.parametrize("make", [lambda: recording()[1], asynchronous])
def test_orders_are_those_of_the_choices_that_were_made(make, policy, monkeypatch):
    """Every selection is followed by a frame of its cameras within its time."""
    made = []

    def spy(*args):
        made.append(choice := choose(*args))
        return choice

    choose = stage.choose
    monkeypatch.setattr(stage, "choose", spy)
    _, d = whole(make(), SelectConfig(policy, 5, selection_interval=3, max_blind_scans=0))
    orders, on = 0, set()
    for choice in made:
        orders += len(on ^ set(choice.cameras))
        on = set(choice.cameras)
    found = counted(d)
    assert (found.orders, found.selections) == (orders, len(made))
    np.testing.assert_array_equal(d.predicted_mse[np.isfinite(d.predicted_mse)], [c.mse for c in made])
    assert found.bytes == 18 * d.n_observing.sum() + 4 * orders


def test_a_selection_that_no_frame_followed_is_in_no_row(monkeypatch):
    """Of the orders those between the rows' selections are counted; docs/explanation/selection.md says so."""
    calls, sets = [], [(0,), (5,), (1,)]  # cam6 is silent when it is asked

    def given(*args):
        calls.append(len(calls))
        return stage.Choice(sets[calls[-1]], 1.0)

    monkeypatch.setattr(stage, "choose", given)
    table = recording(steps=3)[1]
    table = table.take((table.sensor != "cam6") | (table.t_ns != SECOND))
    _, d = whole(table, SelectConfig("greedy", 1, selection_interval=1, max_blind_scans=0))
    assert len(calls) == 3
    assert d.selected.tolist() == ["cam1", "cam2"]
    np.testing.assert_array_equal(d.n_available, [8, 15])
    found = counted(d)
    assert (found.reports, found.offered, found.orders, found.selections) == (2, 23, 3, 2)


def test_every_target_has_a_selection_of_its_own():
    paths, tables = zip(*(recording(1, k) for k in (0, 3)), strict=True)
    config = SelectConfig("closest", 2, selection_interval=1)
    tracks, d = whole(Bearings.merge(list(tables)), config)
    assert set(d.selected[d.target_id == 0].tolist()) != set(d.selected[d.target_id == 3].tolist())
    for k, path in zip((0, 3), paths, strict=True):
        own = d.take(d.target_id == k)
        alone_tracks, alone = whole(tables[(0, 3).index(k)], config)
        np.testing.assert_array_equal(own.selected, alone.selected)
        np.testing.assert_array_equal(tracks.x[tracks.target_id == k], alone_tracks.x)
        # Two reports a scan of 8, for each target.
        assert (counted(own).reports, counted(own).offered) == (2 * STEPS, 8 * STEPS)
        assert len(path) == len(own)
    one, other = (counted(d.take(d.target_id == k)) for k in (0, 3))
    assert counted(d).bytes == one.bytes + other.bytes


def test_closest_cameras_are_near_the_track():
    """The particles that decide are those predicted for the scan: within 4 units of the estimate after it."""
    for seed in range(3):
        tracks, d = whole(recording(seed)[1], SelectConfig("closest", 3, selection_interval=1))
        away = np.hypot(*(np.array(PLACES).T[:, None] - np.array([tracks.x, tracks.y])[:, :, None]))
        for row in range(3, STEPS):
            chosen = np.array([int(name[3:]) - 1 for name in d.selected[row].split(",")])
            rest = np.setdiff1d(np.arange(8), chosen)
            assert away[row, chosen].max() <= away[row, rest].min() + 2 * 4.0


def test_microphone_arrays_are_always_used_and_never_selected():
    scene = with_array(SCENE, (50.0, 50.0), sigma=0.05)
    table = Bearings.merge([recording()[1], of_array()])
    _, d = whole(table, SelectConfig("greedy", 2, selection_interval=5, max_blind_scans=0), scene=scene)
    assert "array" not in ",".join(d.selected)
    np.testing.assert_array_equal(d.n_observing, 3)
    np.testing.assert_array_equal(d.n_available, 9)
    assert all(used.split(",")[-1] == "array" for used in d.cameras)


def test_arrays_alone_with_all_of_no_cameras():
    scene = with_array(SCENE, (50.0, 50.0), sigma=0.05)
    table = Bearings.merge([recording()[1], of_array()])
    _, d = whole(table, SelectConfig("all", selection_interval=10), scene=scene, sensors=frozenset({"array"}))
    assert set(d.selected.tolist()) == {""}
    found = counted(d)
    assert (found.reports, found.orders, found.selections) == (STEPS, 0, 2)


def test_people_raise_the_error_that_is_expected():
    """At the first selection both have the same particles."""
    table, rng = recording()[1], np.random.default_rng(0)
    n = 40
    people = Occluders.of(
        t_ns=np.zeros(n, dtype=np.int64),
        occluder_id=np.arange(n),
        x=rng.uniform(0, 100, n),
        y=rng.uniform(0, 100, n),
        cov_xx=np.full(n, 36.0),
        cov_xy=np.zeros(n),
        cov_yy=np.full(n, 36.0),
    )
    _, free = whole(table, SelectConfig("all"))
    _, among = whole(table, SelectConfig("all"), occluders=[people])
    assert among.predicted_mse[0] > 1.05 * free.predicted_mse[0]


@pytest.mark.statistics
def test_the_error_that_is_expected_is_about_that_of_the_track():
    """10 walks: the mean squared error is within 3 standard errors of what was expected."""
    config, expected, found = ApfConfig(particles=400, initial_particle_factor=2), [], []
    for seed in range(10):
        path, table = recording(seed)
        tracks, d = whole(table, SelectConfig("greedy", 3, selection_interval=1, max_blind_scans=0), config=config)
        expected.append(d.predicted_mse[5:].mean())
        found.append(np.mean((path[5:, 0] - tracks.x[5:]) ** 2 + (path[5:, 1] - tracks.y[5:]) ** 2))
    error = np.std(found) / np.sqrt(10)
    assert error < 0.3 * np.mean(expected)
    assert abs(np.mean(found) - np.mean(expected)) < 3 * error


def test_the_form_in_which_occluders_count_is_that_of_the_filter():
    """Priors much longer than wide tell the forms apart."""
    rng = np.random.default_rng(2)
    mean = rng.uniform(20.0, 80.0, (30, 2))
    priors = gaussian_priors(mean, np.broadcast_to(np.diag([200.0, 1.0]), (30, 2, 2)), 3.33)
    cloud = ParticleSet(rng.uniform(40.0, 60.0, (200, 2)), np.full(200, 1 / 200))
    found = {}
    for q in ("printed", "improved"):
        assert METHOD.prediction is not None
        assert METHOD.prediction.hiding is not None
        hiding = METHOD.prediction.hiding(ApfConfig(occlusion_form=q))
        net = network(SCENE, SelectConfig("greedy", 3), frozenset(c.name for c in SCENE.cameras), None, hiding)
        found[q] = choose(cloud, priors, net, SelectConfig("greedy", 3), rng).mse
    assert found["printed"] != found["improved"]
