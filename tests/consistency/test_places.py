"""Bearings that meet where the scene says that the target cannot be, with the places worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tracker_scenes import SECOND, observe, room100, walk

from occlog.array_types import Floats
from occlog.consistency.bearings import BearingConsistency, ComparedBearings
from occlog.consistency.estimates import PositionConsistency, triangulate_rows
from occlog.consistency.verdict import MAX_FLAGGED_SHARE, MIN_SAMPLES, ConsistencyEvidence
from occlog.records.scene import Camera, MicrophoneArray, Occluder, Scene, camera_rotation
from occlog.records.tables import Bearings, Diagnostics, Residuals, Tracks
from occlog.records.verdicts import findings
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.methods.apf.config import ApfConfig

ROOM = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
SIGMA = 0.01


def camera(name: str, x: float, y: float, yaw_deg: float) -> Camera:
    rotation = camera_rotation(math.radians(yaw_deg), 0.0, 0.0)
    return Camera(name, np.array([x, y, 0.0]), rotation, np.array([200.0, 200.0]), np.zeros(2))


CAMERAS = (camera("east", 0, 5, 0), camera("north", 5, 0, 90))


def pillar(x: float, y: float, half: float = 0.5) -> Occluder:
    return Occluder("pillar", np.array([x, y]) + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]))


def residuals_of(tracks: Tracks, true: Floats, cameras: tuple[Camera, ...] = CAMERAS) -> Residuals:
    """Residuals of bearings without noise from (T, 2) places."""
    n = len(tracks)
    rows = []
    for c in cameras:
        away = true - c.position[:2]
        rows.append(
            Bearings.of(
                t_ns=tracks.t_ns,
                sensor=np.full(n, c.name),
                target_id=np.zeros(n, np.int32),
                seen=np.ones(n, bool),
                bearing=np.arctan2(away[:, 1], away[:, 0]),
                sigma=np.full(n, SIGMA),
                **dict.fromkeys(("u_px", "sigma_px", "score"), np.full(n, np.nan)),
            )
        )
    return BearingConsistency(Scene(cameras)).compare(tracks, Bearings.merge(rows), None)[0]


def estimates(xy: Floats, sigma: float = 0.02) -> Tracks:
    n = len(xy)
    zeros = dict.fromkeys(("vx", "vy", "cov_xy"), np.zeros(n))
    spread = np.full(n, sigma**2)
    return Tracks.of(
        t_ns=np.arange(n) * SECOND,
        target_id=np.zeros(n, np.int32),
        x=xy[:, 0],
        y=xy[:, 1],
        cov_xx=spread,
        cov_yy=spread,
        **zeros,
    )


def standing(x: float, y: float, n: int = 30) -> Floats:
    return np.tile([float(x), float(y)], (n, 1))


def counted(true: Floats, off: Floats, scene: Scene) -> PositionConsistency:
    found, tracks = PositionConsistency(), estimates(true + off)
    found.add(tracks, residuals_of(tracks, true), scene)
    return found


def test_sight_lines_meet_at_the_target_though_the_estimate_is_elsewhere() -> None:
    tracks = estimates(standing(5.1, 5.1, 1))
    used = residuals_of(tracks, standing(5, 5, 1))
    origin = np.array([next(c for c in CAMERAS if c.name == n).position[:2] for n in used.sensor.tolist()])
    met = triangulate_rows(tracks, used, np.zeros(2, np.int64), origin)
    assert met.row.tolist() == [0]
    assert met.xy[0] == pytest.approx([5.0, 5.0], abs=1e-4)
    # 0.01 rad at 5 m across either sight line; the ellipse has two standard deviations
    assert np.hypot(*(met.border[0] - met.xy[0]).T) == pytest.approx(np.full(12, 0.1), rel=0.05)


def test_one_sight_line_or_two_along_each_other_meet_nowhere() -> None:
    tracks = estimates(standing(5, 5, 1))
    one = residuals_of(tracks, standing(5, 5, 1), CAMERAS[:1])
    assert not len(triangulate_rows(tracks, one, np.zeros(1, np.int64), np.array([[0.0, 5.0]])).row)
    facing = (CAMERAS[0], camera("west", 10, 5, 180))
    two = residuals_of(tracks, standing(5, 5, 1), facing)
    origin = np.array([[0.0, 5.0], [10.0, 5.0]])
    assert not len(triangulate_rows(tracks, two, np.zeros(2, np.int64), origin).row)


@pytest.mark.parametrize(("x", "outside"), [(9.85, 0), (10.05, 0), (10.45, 30)])
def test_a_target_is_outside_the_room_from_two_standard_deviations_on(x: float, outside: int) -> None:
    """At x = 10.45 `north` sees along a sight line of 7.4 m: 2 sigma across are 0.15 m."""
    scene = Scene(CAMERAS, room=ROOM)
    found = counted(standing(x, 5.0), np.array([-0.05, 0.0]), scene)
    assert (found.rows, found.outside) == (30, outside)


@pytest.mark.parametrize(("y", "hidden"), [(7.3, 0), (5.5, 0), (5.0, 30)])
def test_a_target_is_behind_a_wall_from_two_standard_deviations_on(y: float, hidden: int) -> None:
    """At x = 5 the pillar's shadow from `east` reaches 0.56 m to either side; 2 sigma are 0.1 m."""
    scene = Scene(CAMERAS, (), (pillar(4, 5, 0.4),), room=ROOM)
    found = counted(standing(5, y), np.array([0.0, 0.05]), scene)
    assert found.hidden["east"] == (30, hidden)
    assert found.hidden["north"] == (30, 0)


def test_sound_goes_past_walls() -> None:
    """What `east` hears of a target behind the pillar contradicts no wall."""
    scene = Scene(CAMERAS[1:], (MicrophoneArray("east", CAMERAS[0].position),), (pillar(4, 5, 0.4),), room=ROOM)
    found = counted(standing(5, 5), np.array([0.0, 0.05]), scene)
    assert (found.rows, found.hidden) == (30, {"north": (30, 0)})


def test_only_sensors_that_saw_the_target_speak_against_a_wall() -> None:
    scene = Scene((*CAMERAS, camera("far", 10, 5, 180)), (), (pillar(8, 5),), room=ROOM)
    found = counted(standing(5, 5), np.zeros(2), scene)
    assert found.hidden["far"] == (0, 0)


def test_scenes_without_walls_and_room_say_nothing() -> None:
    assert counted(standing(50, 50), np.zeros(2), Scene(CAMERAS)) == PositionConsistency()


@pytest.mark.parametrize("what", ["outside-room", "detection-through-wall"])
def test_a_few_rows_are_no_finding_but_more_than_chance_are(what: str) -> None:
    n = 1000
    for share, reported in ((MAX_FLAGGED_SHARE, False), (2.0 * MAX_FLAGGED_SHARE, True)):
        bad = round(share * n)
        places = (
            PositionConsistency(n, bad) if what == "outside-room" else PositionConsistency(n, 0, {"east": (n, bad)})
        )
        codes = [f.id for f in findings(ConsistencyEvidence(rows=n, positions=places).checks(one_target=True))]
        assert codes == [what] * reported
    few = PositionConsistency(MIN_SAMPLES - 1, MIN_SAMPLES - 1, {"east": (MIN_SAMPLES - 1, MIN_SAMPLES - 1)})
    assert not findings(ConsistencyEvidence(rows=n, positions=few).checks(one_target=True))


@pytest.mark.jit
@pytest.mark.parametrize("standing_there", [True, False])
def test_a_pillar_that_is_not_there_makes_a_wrong_track_and_the_verdict_says_so(standing_there: bool) -> None:
    """Five blunt cameras see a target through where the scene has a pillar; residuals stay small."""
    noises = {"sigma_position": 3.2, "sigma_yaw": 0.032, "sigma_read_px": 8.0}
    scene = room100(pillar=standing_there, focal=160.0, cameras=5, fov=1.5, **noises)
    rng = np.random.default_rng(8)
    path = walk(100, rng)
    bearings = observe(scene, path, rng)
    parts = list(track([bearings], scene, TrackingTask(ApfConfig(), 0)))
    tracks, diagnostics = Tracks.concat(p.tracks for p in parts), Diagnostics.concat(p.diagnostics for p in parts)
    found = ConsistencyEvidence()
    found.add_diagnostics(diagnostics)
    found.saw(tracks, ComparedBearings(*BearingConsistency(scene).compare(tracks, bearings, diagnostics)), scene)
    rmse = np.sqrt(np.mean(np.sum((np.column_stack([tracks.x, tracks.y]) - path)[10:] ** 2, axis=1)))
    codes = {f.id for f in findings(found.checks(one_target=True))}
    assert codes == ({"detection-through-wall"} if standing_there else set())
    assert rmse > 6.0 if standing_there else rmse < 3.0
