"""Static clutter of one camera, and misses and false people of all cameras at once, in simulated crowds."""

from __future__ import annotations

import numpy as np
import pytest
from crowds import Crowd, crowd

from occlog.track.methods.jipda.config import JipdaConfig
from occlog.track.methods.jipda.detector_model import (
    Clutter,
    common_clutter_rate,
    detector_model,
    established,
    no_clutter,
    source_rates,
    update_sources,
)
from occlog.track.methods.jipda.filter import JipdaState, initial_state, step
from occlog.track.methods.jipda.interface import NO_ID, FrameDetections, TrackSnapshot
from occlog.track.methods.jipda.kernels.body_box import expected_box, pack_views

pytestmark = pytest.mark.jit
NOISE = np.array([[8.0, 1e-4], [20.0, 4e-4], [6.0, 1e-4], [15.0, 2e-4]])
BOX = np.array([[100.0, 50.0, 130.0, 130.0]])


def followed(made: Crowd) -> tuple[JipdaState, list[TrackSnapshot]]:
    """The last state and all snapshots."""
    state, out = initial_state(made.scene, made.scene.cameras, JipdaConfig()), []
    for frames in made.moments:
        state, snapshot = step(state, frames)
        out.append(snapshot)
    return state, out


def with_box(frame: FrameDetections, box: np.ndarray) -> FrameDetections:
    """The frame with one more box."""
    return frame._replace(
        boxes=np.concatenate([frame.boxes, box[None]]),
        score=np.append(frame.score, np.nan),
        tracklet_id=np.append(frame.tracklet_id, NO_ID),
        appearance=np.concatenate([frame.appearance, np.full((1, frame.appearance.shape[1]), np.nan)]),
        row=np.append(frame.row, 10_000),
    )


def with_object(made: Crowd, camera: int, xy: tuple[float, float], seed: int = 0) -> Crowd:
    """The crowd, with a static object of a person's size that one camera reports in every frame."""
    rng, box = np.random.default_rng(seed), np.empty(4)
    assert expected_box(pack_views(made.scene.cameras).lens[camera], *xy, 1.7, 0.5, box) > 0.0
    frames = [
        [with_box(f, box + rng.normal(0.0, 1.5, 4)) if f.camera == camera else f for f in group]
        for group in made.moments
    ]
    return made._replace(moments=frames)


def near(snapshots: list[TrackSnapshot], xy: tuple[float, float], truth: np.ndarray) -> int:
    """Number of time steps with a track within 0.5 m of a position with no true person within 0.9 m."""
    count = 0
    for snapshot, there in zip(snapshots, truth, strict=True):
        free = np.hypot(*(there - xy).T).min() > 0.9
        count += int(free and bool((np.hypot(*(snapshot.mean[:, :2] - xy).T) < 0.5).any()))
    return count


@pytest.mark.parametrize(("camera", "xy"), [(0, (5.0, 4.0)), pytest.param(3, (7.0, 2.5), marks=pytest.mark.statistics)])
def test_an_object_that_one_of_four_cameras_reports_is_no_person_after_3_s(camera, xy):
    made = with_object(crowd(people=4, frames=100, seed=2), camera, xy)
    _, snapshots = followed(made)
    assert near(snapshots[30:], xy, made.truth[30:]) <= 3
    assert snapshots[-1].detectors is not None
    assert snapshots[-1].detectors.static_clutter[camera] == 1
    assert snapshots[-1].detectors.static_clutter.sum() == 1


def plain_views(made: Crowd, xy: tuple[float, float]) -> list[int]:
    """Cameras with the whole box of a person at the position in their image."""
    out, box = [], np.empty(4)
    for c, lens in enumerate(pack_views(made.scene.cameras).lens):
        seen = expected_box(lens, *xy, 1.7, 0.5, box) > 0.0
        if seen and box.min() > 0.0 and box[2] < 1279.0 and box[3] < 719.0:
            out.append(c)
    return out


@pytest.mark.parametrize(
    ("seed", "camera", "xy"), [(7, 1, (6.5, -1.0)), pytest.param(5, 0, (3.8, -1.0), marks=pytest.mark.statistics)]
)
def test_an_object_that_a_single_other_camera_denies_is_no_person_after_3_s(seed, camera, xy):
    made = with_object(crowd(people=4, frames=100, seed=seed), camera, xy)
    views = plain_views(made, xy)
    assert camera in views
    assert len(views) == 2
    _, snapshots = followed(made)
    assert near(snapshots[30:], xy, made.truth[30:]) <= 3


def test_a_crowd_without_such_objects_has_no_static_clutter():
    _, snapshots = followed(crowd(people=6, frames=80, seed=2))
    assert all(s.detectors is not None and not s.detectors.static_clutter.any() for s in snapshots)


@pytest.mark.parametrize(("cameras", "xy"), [((1,), (5.0, 4.0)), ((3, 1), (1.1, 6.5))])
def test_a_person_who_stands_in_view_of_one_camera_alone_is_kept(cameras, xy):
    """60 s at 5 Hz: the first camera detects the person, of whom the image of the second one contains a third."""
    made = crowd(people=1, frames=1, hz=5.0, seed=4, false=0.0)
    own, box = tuple(made.scene.cameras[c] for c in cameras), np.empty(4)
    assert expected_box(pack_views(own).lens[0], *xy, 1.7, 0.5, box) > 0.0
    rng, state, kept = np.random.default_rng(1), initial_state(made.scene, own, JipdaConfig()), 0
    for t in range(300):
        frames = [
            made.moments[0][0]._replace(
                t_ns=round(0.2e9 * t), camera=c, boxes=np.zeros((0, 4)), score=np.zeros(0),
                tracklet_id=np.zeros(0, np.int64), appearance=np.zeros((0, 0)), row=np.zeros(0, np.int64),
            )
            for c in range(len(cameras))
        ]  # fmt: skip
        if rng.random() < 0.9:
            frames[0] = with_box(frames[0], box + rng.normal(0.0, 3.0, 4))
        state, snapshot = step(state, frames)
        kept += len(snapshot.ids)
    assert kept > 280


def test_people_whom_all_cameras_miss_at_once_keep_their_identity():
    rng = np.random.default_rng(3)
    made = crowd(people=5, cameras=4, frames=150, hz=4.0, miss=0.0, false=0.0, seed=6)
    views, lost = pack_views(made.scene.cameras), rng.random((150, 5)) < 0.08
    frames = []
    for group, missed, there in zip(made.moments, lost, made.truth, strict=True):
        out = []
        for frame in group:
            keep, box = np.ones(len(frame.boxes), dtype=bool), np.empty(4)
            for x, y in there[missed]:
                if expected_box(views.lens[frame.camera], x, y, 1.7, 0.52, box) > 0.0 and len(frame.boxes):
                    keep[np.abs(frame.boxes - box).sum(axis=1).argmin()] = False
            out.append(
                frame._replace(
                    boxes=frame.boxes[keep],
                    score=frame.score[keep],
                    tracklet_id=frame.tracklet_id[keep],
                    appearance=frame.appearance[keep],
                    row=frame.row[keep],
                )
            )
        frames.append(out)
    state, snapshots = followed(made._replace(moments=frames))
    rates = detector_model(state.counts, state.edges, state.config, np.full(4, 0.25))
    # 750 people-frames: a standard error of 0.01; a removed box may be that of a neighbour
    assert 0.03 < rates.common_miss < 0.12
    assert len({k for s in snapshots for k in s.ids.tolist()}) <= 8


def test_false_people_in_all_cameras_are_counted_and_confirmed_by_a_second_time_step():
    rng = np.random.default_rng(4)
    made = crowd(people=4, cameras=4, frames=150, hz=2.0, miss=0.0, false=0.0, seed=7)
    views, frames, false = pack_views(made.scene.cameras), [], []
    for group in made.moments:
        xy, box = rng.uniform([1.0, 1.0], [9.0, 7.0]), np.empty(4)
        false.append(xy)
        out = []
        for frame in group:
            ok = expected_box(views.lens[frame.camera], *xy, 1.7, 0.5, box) > 0.0
            inside = ok and box[0] > 0.0 and box[1] > 0.0 and box[2] < 1279.0 and box[3] < 719.0
            out.append(with_box(frame, box + rng.normal(0.0, 1.0, 4)) if inside else frame)
        frames.append(out)
    state, snapshots = followed(made._replace(moments=frames))
    # One a time step; where they stand near people, or follow each other, they are not distinguished
    assert common_clutter_rate(state.counts) > 0.06
    shown = [
        np.hypot(*(s.mean[:, :2] - xy).T).min(initial=9.0) < 0.3 and np.hypot(*(there - xy).T).min() > 0.8
        for s, xy, there in zip(snapshots[75:], false[75:], made.truth[75:], strict=True)
    ]
    # 0.81 if every new track counts as a person at once
    assert np.mean(shown) < 0.4


def test_sources_are_matched_counted_forgotten_and_established():
    sources, _ = update_sources(no_clutter(), BOX, np.array([0.9]), 0.25, NOISE, 0.25)
    assert source_rates(sources, 0.25) == pytest.approx([0.9 * 0.25])
    assert not len(established(sources).box)
    counted = (0.0, 0.0)
    for k in range(10):
        sources, counted = update_sources(sources, BOX + 0.5 * (-1) ** k, np.ones(1), 0.25, NOISE, 0.25)
        if k == 0:
            assert counted == pytest.approx((0.9, 0.9))
    assert counted == (0.0, 0.0)
    assert len(established(sources).box) == 1
    assert source_rates(sources, 0.25)[0] > 0.8
    # A box that a person claims is no evidence against the source; frames without one are
    claimed, _ = update_sources(sources, BOX, np.zeros(1), 0.25, NOISE, 0.25)
    assert source_rates(claimed, 0.25)[0] == pytest.approx(source_rates(sources, 0.25)[0], abs=0.01)
    for _ in range(200):
        sources, _ = update_sources(sources, np.zeros((0, 4)), np.zeros(0), 0.25, NOISE, 0.25)
    assert isinstance(sources, Clutter)
    assert not len(established(sources).box)
    away, _ = update_sources(claimed, BOX + 40.0, np.ones(1), 0.25, NOISE, 0.25)
    assert len(away.box) == 2


def test_boxes_that_move_are_no_static_object():
    """40 frames in 1.6 s, 4 px each: more than a box's noise from the mean of the boxes before."""
    sources, across = no_clutter(), np.array([4.0, 0.0, 4.0, 0.0])
    for k in range(40):
        sources, _ = update_sources(sources, BOX + k * across, np.ones(1), 0.25, NOISE, 0.04)
        assert not len(established(sources).box)
