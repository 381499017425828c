"""The track stage: targets, seeds, streaming, what goes into the tables."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tracker_scenes import SECOND, observe, room100, walk

from occlog.errors import UsageError
from occlog.records.tables import UNLABELLED, Bearings, Diagnostics, Tracks
from occlog.scans.grouping import choose_sensors
from occlog.track.catalogue import BEARINGS, METHODS, settings_of, tracker
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.methods.apf.config import ApfConfig

pytestmark = pytest.mark.jit

SCENE = room100(pillar=False)
CONFIG = ApfConfig(particles=200, initial_particle_factor=2)
FEW = ApfConfig(particles=40, initial_particle_factor=2)


def recording(steps=25, targets=(0,), seed=0):
    parts = []
    for k in targets:
        rng = np.random.default_rng([seed, k])
        parts.append(observe(SCENE, walk(steps, rng), rng, target=k))
    return Bearings.merge(parts)


def unlabelled(bearings):
    values = {c.name: getattr(bearings, c.name) for c in Bearings.columns()}
    values["target_id"] = np.full(len(bearings), UNLABELLED, dtype=np.int32)
    return Bearings(**values)


def whole(parts):
    parts = list(parts)
    return Tracks.concat(p.tracks for p in parts), Diagnostics.concat(p.diagnostics for p in parts)


def same(a, b):
    return all(
        np.array_equal(getattr(a, c.name), getattr(b, c.name), equal_nan=a.columns and c.kind == "f8")
        for c in a.columns()
    )


def test_a_row_for_every_scan_and_what_it_says():
    bearings = recording(25)
    tracks, diagnostics = whole(track([bearings], SCENE, TrackingTask(CONFIG, 0)))
    assert len(tracks) == len(diagnostics) == 25
    np.testing.assert_array_equal(tracks.t_ns, np.arange(25) * SECOND)
    assert set(tracks.target_id.tolist()) == {0}
    seen = [int(bearings.seen[bearings.t_ns == t].sum()) for t in tracks.t_ns]
    np.testing.assert_array_equal(diagnostics.n_detected, seen)
    np.testing.assert_array_equal(diagnostics.n_observing, 8)
    assert set(diagnostics.cameras.tolist()) == {",".join(f"cam{i}" for i in range(1, 9))}
    assert np.all((diagnostics.ess >= 1) & (diagnostics.ess <= 200.0 + 1e-9))
    assert np.all(np.isfinite(diagnostics.log_likelihood))
    assert set(diagnostics.fallback.tolist()) == {""}


def test_the_same_seed_gives_the_same_track_and_another_seed_another():
    bearings = recording()
    first, again = (
        whole(track([bearings], SCENE, TrackingTask(FEW, 3))),
        whole(track([bearings], SCENE, TrackingTask(FEW, 3))),
    )
    assert all(same(a, b) for a, b in zip(first, again, strict=True))
    assert not same(first[0], whole(track([bearings], SCENE, TrackingTask(FEW, 4)))[0])


def test_the_track_does_not_depend_on_where_the_input_is_cut():
    bearings = recording(12, targets=(0, 2))
    expected = whole(track([bearings], SCENE, TrackingTask(FEW, 1)))
    for rows in (1, 7, 64, 191):
        parts = [bearings.take(slice(a, a + rows)) for a in range(0, len(bearings), rows)]
        assert all(same(a, b) for a, b in zip(whole(track(parts, SCENE, TrackingTask(FEW, 1))), expected, strict=True))


def test_each_labelled_target_has_a_track_of_its_own_that_does_not_depend_on_the_others():
    both = recording(targets=(0, 5))
    tracks, _ = whole(track([both], SCENE, TrackingTask(FEW, 0)))
    assert tracks.target_id.tolist() == [0, 5] * 25
    for k in (0, 5):
        alone, _ = whole(track([recording(targets=(k,))], SCENE, TrackingTask(FEW, 0)))
        assert same(alone, tracks.take(tracks.target_id == k))
        chosen, _ = whole(track([both], SCENE, TrackingTask(FEW, 0, targets=(k,))))
        assert same(alone, chosen)


def test_unlabelled_candidates_make_one_track():
    bearings = unlabelled(recording())
    tracks, diagnostics = whole(track([bearings], SCENE, TrackingTask(CONFIG, 0)))
    assert set(tracks.target_id.tolist()) == {0}
    assert len(tracks) == 25
    labelled, _ = whole(track([recording()], SCENE, TrackingTask(CONFIG, 0)))
    late = slice(10, None)
    apart = np.hypot(tracks.x - labelled.x, tracks.y - labelled.y)[late]
    assert np.median(apart) < 1.5
    assert diagnostics.n_observing.tolist() == [8] * 25
    numbered, _ = whole(track([bearings], SCENE, TrackingTask(CONFIG, 0, targets=(9,))))
    assert set(numbered.target_id.tolist()) == {9}


def test_candidates_can_be_left_out():
    assert list(track([unlabelled(recording())], SCENE, TrackingTask(CONFIG, 0, unlabelled=False))) == []


def test_candidates_of_cameras_without_a_label_help_a_labelled_target():
    bearings = recording(40)
    odd = np.isin(bearings.sensor, ["cam1", "cam3", "cam5", "cam7"])
    mixed = Bearings.merge([unlabelled(bearings.take(odd)), bearings.take(~odd)])
    tracks, diagnostics = whole(track([mixed], SCENE, TrackingTask(ApfConfig(particles=600), 0)))
    assert set(tracks.target_id.tolist()) == {0}
    assert set(diagnostics.n_observing.tolist()) == {8}
    some, _ = whole(track([bearings.take(~odd)], SCENE, TrackingTask(ApfConfig(particles=600), 0)))
    spread = [np.sqrt(np.median(t.cov_xx + t.cov_yy)) for t in (tracks, some)]
    assert spread[0] < 0.95 * spread[1]


def test_a_target_may_appear_later_and_disappear():
    bearings = recording(targets=(0, 1))
    late = (bearings.target_id == 0) | ((bearings.t_ns >= 10 * SECOND) & (bearings.t_ns < 15 * SECOND))
    tracks, _ = whole(track([bearings.take(late)], SCENE, TrackingTask(CONFIG, 0)))
    ones = tracks.take(tracks.target_id == 1)
    np.testing.assert_array_equal(ones.t_ns, np.arange(10, 15) * SECOND)


def test_only_the_chosen_sensors_are_used():
    used = choose_sensors(SCENE, only=["cam1", "cam2", "cam3"], without=["cam2"])
    assert used == {"cam1", "cam3"}
    tracks, diagnostics = whole(track([recording()], SCENE, TrackingTask(CONFIG, 0, sensors=used)))
    assert len(tracks) == 25
    assert set(diagnostics.cameras.tolist()) == {"cam1,cam3"}


def test_unknown_sensors_and_none_at_all_are_refused():
    with pytest.raises(UsageError, match="no sensor 'cam0' in the scene, to be used or omitted; did you mean 'cam"):
        choose_sensors(SCENE, only=["cam0"])
    with pytest.raises(UsageError, match="all sensors are omitted"):
        choose_sensors(SCENE, only=["cam1"], without=["cam1"])


def test_a_start_for_two_targets_is_refused():
    config = ApfConfig(particles=50, start=(50.0, 50.0, 1.0))
    with pytest.raises(UsageError, match=r"target 2 in addition to 1; choose one target, e\.g\. --target 2"):
        list(track([recording(targets=(1, 2))], SCENE, TrackingTask(config, 0)))
    tracks, _ = whole(track([recording(targets=(1, 2))], SCENE, TrackingTask(config, 0, targets=(2,))))
    assert set(tracks.target_id.tolist()) == {2}


def test_nothing_comes_of_nothing():
    assert list(track([], SCENE, TrackingTask(CONFIG, 0))) == []
    assert list(track([Bearings.empty(), Bearings.empty()], SCENE, TrackingTask(CONFIG, 0))) == []


def test_an_unknown_method_is_refused_with_the_names_of_those_there_are():
    with pytest.raises(UsageError, match="no tracking method 'kalman'"):
        tracker("kalman")
    assert all(
        tracker(name).config is settings_of(name) for name, entry in METHODS.items() if entry.takes_in == BEARINGS
    )


def test_output_comes_while_input_is_read():
    """The stage holds a scan and some rows of output, not the recording."""
    read = 0

    def chunks():
        nonlocal read
        bearings = recording(30)
        for k in range(400):
            read = k
            shifted = {c.name: getattr(bearings, c.name) for c in Bearings.columns()}
            shifted["t_ns"] = bearings.t_ns + 30 * SECOND * k
            yield Bearings(**shifted)

    first = next(iter(track(chunks(), SCENE, TrackingTask(ApfConfig(particles=1), 0))))
    assert read < 399
    assert len(first.tracks) >= 1


def test_rows_are_doubted_while_the_clock_of_one_sensor_is_wrong():
    bearings = recording(80)
    bearings = replace(bearings, t_ns=bearings.t_ns // 10)  # ten rows a second
    assert "inconsistent_sensor" not in whole(track([bearings], SCENE, fixes()))[1].quality_flags.tolist()
    rows = np.flatnonzero(bearings.sensor == "cam7")
    measured = np.arange(len(bearings))
    measured[rows[40:60]] = rows[:20]
    late = {c.name: getattr(bearings, c.name)[measured] for c in Bearings.columns()} | {"t_ns": bearings.t_ns}
    doubt = whole(track([Bearings(**late)], SCENE, fixes()))[1].quality_flags
    assert "inconsistent_sensor" not in doubt[:40].tolist() + doubt[70:].tolist()
    assert np.count_nonzero(doubt[45:60] == "inconsistent_sensor") >= 10


def fixes() -> TrackingTask:
    return TrackingTask(settings_of("fix").in_unit("unit"), 0, method="fix")
