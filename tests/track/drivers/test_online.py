"""The driver of online methods: what it gives to a method and when, by methods that remember their calls."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import pytest
from tracker_scenes import SECOND, observe, room100, walk

from occlog.errors import UsageError
from occlog.records.tables import UNLABELLED, Bearings, Diagnostics, Occluders, Tracks
from occlog.track.drivers.online import FIRST_TARGET, track_online
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.interface import Estimate, OccluderTerms, Online, ParticleSet, TargetPredictor
from occlog.track.methods.apf.selector import SelectConfig

SCENE = room100(pillar=False)
NAMES = [c.name for c in SCENE.cameras]


@dataclass(frozen=True)
class Settings:
    """Of the methods below."""

    start: tuple[float, ...] | None = None
    silent: int = 0  # scans that give no estimate


class Seen(NamedTuple):
    """State of the methods below: the scans so far."""

    config: Settings
    scans: tuple


def init(_scene, config, _rng):
    return Seen(config, ())


def step(state, scan, rng):
    """The estimate is at (time, number of rows), its log-likelihood a random number."""
    state = state._replace(scans=(*state.scans, scan))
    if len(state.scans) <= state.config.silent:
        return state, None
    sensors = np.unique(scan.sensor)
    return state, Estimate(
        xy=np.array([scan.t_ns / SECOND, len(scan.sensor)]),
        velocity=np.zeros(2),
        covariance=np.eye(2),
        ess=np.nan,
        log_likelihood=rng.random(),
        n_observing=len(sensors),
        n_detected=int(scan.seen.sum()),
        fallback="" if scan.occluders is None else f"{len(scan.occluders.mean)} occluders",
        used=tuple(sensors.tolist()),
    )


def cloud(_state, _t_ns, rng):
    return ParticleSet(rng.uniform(40.0, 60.0, (50, 2)), np.full(50, 0.02))


METHOD = Online(config=Settings, init=init, step=step, started=lambda config: config.start is not None)
INFORMED = METHOD._replace(occluders=lambda _: OccluderTerms(diameter=1.0, max_age_s=2.0))
SELECTING = METHOD._replace(prediction=TargetPredictor(cloud, lambda _: 2.0, lambda _: None))


def seen(steps=5, target=0, cameras=NAMES, first=0):
    rng = np.random.default_rng(target)
    made = observe(SCENE, walk(steps, rng), rng, target=target)
    return replace(made.take(np.isin(made.sensor, cameras)), t_ns=made.take(np.isin(made.sensor, cameras)).t_ns + first)


def run(bearings, method=METHOD, config=None, occluders=None, seed=0, **options):
    parts = list(track_online(bearings, SCENE, method, TrackingTask(config or Settings(), seed, **options), occluders))
    return Tracks.concat(p.tracks for p in parts), Diagnostics.concat(p.diagnostics for p in parts)


def test_every_target_has_a_row_for_every_scan_once_it_was_met() -> None:
    both = Bearings.merge([seen(5, 0), seen(3, 4, cameras=["cam1"], first=2 * SECOND)])
    tracks, diagnostics = run([both])
    met = [(t, k) for t in range(5) for k in (0, 4) if k == 0 or t >= 2]
    assert list(zip((tracks.t_ns // SECOND).tolist(), tracks.target_id.tolist(), strict=True)) == met
    assert diagnostics.n_observing[diagnostics.target_id == 4].tolist() == [1, 1, 1]


def test_a_target_that_was_met_gets_candidates_but_no_rows_of_others() -> None:
    candidates = replace(seen(4, 0, cameras=["cam2"]), target_id=np.full(4, UNLABELLED, dtype=np.int32))
    mixed = Bearings.merge([seen(4, 1, cameras=["cam1"]), candidates, seen(1, 6, cameras=["cam3"])])
    tracks, diagnostics = run([mixed])
    assert diagnostics.cameras[tracks.target_id == 1].tolist() == ["cam1,cam2"] * 4
    # Target 6 has a row of its own at the first time only, and candidates of cam2 after it.
    assert diagnostics.cameras[tracks.target_id == 6].tolist() == ["cam2,cam3", "cam2", "cam2", "cam2"]


@pytest.mark.parametrize(("targets", "identity"), [(None, FIRST_TARGET), ((9, 3), 9)])
def test_candidates_alone_make_one_track(targets, identity) -> None:
    empty = replace(seen(3), target_id=np.full(3 * len(NAMES), UNLABELLED, dtype=np.int32))
    tracks, _ = run([empty], targets=targets)
    assert tracks.target_id.tolist() == [identity] * 3


def test_random_numbers_of_a_target_do_not_depend_on_the_others() -> None:
    together, diagnostics = run([Bearings.merge([seen(4, 0), seen(4, 5)])], seed=3)
    _, alone = run([seen(4, 5)], seed=3)
    np.testing.assert_array_equal(diagnostics.log_likelihood[together.target_id == 5], alone.log_likelihood)
    assert not np.array_equal(run([seen(4, 5)], seed=4)[1].log_likelihood, alone.log_likelihood)


def test_frames_of_scans_without_an_estimate_count_in_the_next_row() -> None:
    tracks, diagnostics = run([seen(4)], config=Settings(silent=2))
    assert (tracks.t_ns // SECOND).tolist() == [2, 3]
    assert diagnostics.n_available.tolist() == [3 * len(NAMES), len(NAMES)]


def test_one_start_is_for_one_target() -> None:
    config = Settings(start=(1.0, 2.0, 3.0))
    assert len(run([seen(2, 7)], config=config)[0]) == 2
    with pytest.raises(
        UsageError, match="start is the position of one target, but there is target 7 in addition to 0; choose one"
    ):
        run([Bearings.merge([seen(2, 0), seen(2, 7)])], config=config)


def test_occluders_come_with_the_scan_until_they_are_too_old() -> None:
    people = Occluders.of(
        t_ns=[SECOND, SECOND],
        occluder_id=[0, 1],
        x=[5.0, 6.0],
        y=[5.0, 6.0],
        cov_xx=[1, 1],
        cov_xy=[0, 0],
        cov_yy=[1, 1],
    )
    _, diagnostics = run([seen(5)], INFORMED, occluders=[people])
    # Known from 1 s on, and not used when they are more than 2 s old.
    assert diagnostics.fallback.tolist() == ["", *["2 occluders"] * 3, ""]
    with pytest.raises(UsageError, match="occluders: method apf does not use moving occluders"):
        run([seen(5)], METHOD, occluders=[people])


def test_cameras_are_selected_again_after_so_many_reference_steps() -> None:
    selection = SelectConfig("random", 2, selection_interval=1.5)  # of 2 s
    _, diagnostics = run([seen(9)], SELECTING, selection=selection)
    assert np.flatnonzero(np.isfinite(diagnostics.predicted_mse)).tolist() == [0, 3, 6]
    assert all(len(names.split(",")) == 2 for names in diagnostics.cameras)
    np.testing.assert_array_equal(diagnostics.cameras, diagnostics.selected)
    with pytest.raises(UsageError, match="select: method apf cannot predict where the target will be"):
        run([seen(9)], METHOD, selection=selection)


def test_a_scan_of_cameras_that_are_not_asked_gives_no_row() -> None:
    late = seen(2, 0, cameras=["cam5"], first=SECOND // 2)
    every = Bearings.merge([seen(2, 0, cameras=["cam1", "cam2"]), late])
    tracks, diagnostics = run([every], SELECTING, selection=SelectConfig("fixed", 2, selection_interval=1e6))
    assert tracks.t_ns.tolist() == [0, SECOND]
    assert diagnostics.n_available.tolist() == [2, 3]  # the frame of cam5 at 0.5 s counts in the row at 1 s
