"""Sight lines and half-planes of method `map`: readings back from places, and what a sighting rules out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from map_scenes import FOCAL, place, record, square
from numpy.testing import assert_allclose
from shapely.geometry import LineString, Polygon

from occlog.records.scene import Occluder
from occlog.track.methods.map.config import MapConfig
from occlog.track.methods.map.kernels.problem import slack
from occlog.track.methods.map.kernels.terms import residuals
from occlog.track.methods.map.measurements import constraints, convex_hull, first_hit, lines_of_sight, stations

ORIGIN = np.zeros(2)
L_ROOM = np.array([[-10.0, -10], [10, -10], [10, 0], [0, 0], [0, 10], [-10, 10]])
BLOCK = np.array([[-2.0, 3.0], [2.0, 3.0], [2.0, 4.0], [-2.0, 4.0]])


def states(xy):
    X = np.zeros((len(xy), 4))
    X[:, ::2] = xy
    return X


def planes_of(scene, xy, config=MapConfig(), **options):  # noqa: B008
    """Half-planes and stations for a target seen once a second at places (T, 2)."""
    made = record(scene, np.arange(len(xy)), xy, **options)
    at = stations(scene, ORIGIN, walls=config.wall_constraints)
    lines = lines_of_sight(made, at)
    return constraints(lines, made, at, config, len(xy)), lines, made


def nearest_crossing(eye, angle, polygons) -> int:
    """Which of several polygons' edges, counted through, a ray meets first, by shapely."""
    far = eye + 100.0 * np.array([np.cos(angle), np.sin(angle)])
    best, found, count = np.inf, -1, 0
    for polygon in polygons:
        for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
            hit = LineString([eye, far]).intersection(LineString([a, b]))
            if not hit.is_empty and np.hypot(hit.x - eye[0], hit.y - eye[1]) < best:
                best, found = np.hypot(hit.x - eye[0], hit.y - eye[1]), count
            count += 1
    return found


@pytest.mark.parametrize("seed", range(3))
def test_the_first_edge_on_a_ray(seed: int) -> None:
    rng = np.random.default_rng(seed)
    walls = [square(rng.uniform(0.3, 1.5), *rng.uniform(-8, 8, 2)) @ _turn(rng.uniform(0, 2)) for _ in range(6)]
    eye = np.array([15.0, -12.0])
    bearing = rng.uniform(np.pi / 2, np.pi, 200)
    edge = np.vstack([np.roll(w, -1, axis=0) - w for w in walls])
    got = first_hit(eye, bearing, np.vstack(walls), edge)
    assert got.tolist() == [nearest_crossing(eye, b, walls) for b in bearing]
    assert got.max() > -1
    assert got.min() == -1


def _turn(angle: float):
    return np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


def test_edges_behind_next_to_and_along_a_ray_are_not_met() -> None:
    start = np.array([[-1.0, -1.0], [1.0, 0.5], [2.0, 0.0]])
    edge = np.array([[0.0, 2.0], [1.0, 1.0], [1.0, 0.0]])  # behind; next to; along the ray itself
    assert first_hit(np.zeros(2), np.array([0.0]), start, edge).tolist() == [-1]


def test_residuals_vanish_at_the_place_that_was_seen() -> None:
    """Of cameras and arrays; noise is [Ercan] Eq. 2 at the reading."""
    scene = place((-5, -5, 45), (5, -5, 135), arrays=((0, 8, -90),), sigma_yaw=0.01, sigma_position=0.1)
    xy = np.array([[0.3, 0.2], [-1.0, 1.5], [2.0, 0.0]])
    made = record(scene, np.arange(3), xy)
    at = stations(scene, ORIGIN, walls=True)
    lines = lines_of_sight(made, at)
    assert len(lines.step) == made.rows.seen.sum() == 9
    assert lines.direction.reshape(3, 3)[:, 2].all()
    assert_allclose(residuals(lines, states(xy)), 0.0, atol=1e-9)
    c = ~lines.direction
    h_d = lines.reading[c] / FOCAL
    away = xy[lines.step[c]] - lines.position[c]
    d = np.einsum("ni,ni->n", away, lines.axis[c])
    want = FOCAL**2 * (1 + h_d**2) ** 2 * 0.01**2 + FOCAL**2 * (1 + h_d**2) * 0.1**2 / d**2 + 0.5**2
    assert_allclose(lines.c0[c] + lines.c1[c] / d**2, want)


def test_a_bearing_far_off_the_axis_counts_as_a_direction() -> None:
    scene = place((0, 0, 0), fov=np.radians(179.9))
    xy = np.array([[1.0, 2.0], [0.01, 3.0]])  # 63 and 89.8 degrees off
    made = record(scene, [0.0, 1.0], xy)
    lines = lines_of_sight(made, stations(scene, ORIGIN, walls=True))
    assert lines.direction.tolist() == [False, True]
    assert_allclose(residuals(lines, states(xy)), 0.0, atol=1e-9)


def test_in_front_of_a_camera_that_saw_it() -> None:
    scene = place((0, -5, 90))
    bare = MapConfig(wall_constraints=False)
    planes, _, made = planes_of(scene, np.array([[0.5, 0.0], [9.0, -5.0]]), bare)
    assert made.rows.seen.tolist() == [True, False]
    assert planes.step.tolist() == [0]  # nothing of the state that was not seen
    gap = [slack(planes, states([p, p]))[0] for p in ([3.0, -4.0], [3.0, -5.0], [0.0, -6.0])]
    assert_allclose(gap, [1.0 - 0.01, -0.01, -1.01])
    assert not len(planes_of(scene, np.array([[0.5, 0.0]]), replace(bare, in_front_constraint=False))[0].step)


def test_within_the_range_of_a_camera() -> None:
    scene = place((0, -5, 90), range=6.0)
    planes, *_ = planes_of(scene, np.array([[0.5, 0.0]]), MapConfig(wall_constraints=False))
    assert len(planes.step) == 2
    assert (slack(planes, states([[0.5, 0.9]])) > 0).all()
    assert slack(planes, states([[0.5, 1.1]])).min() == pytest.approx(-0.1)


@pytest.mark.parametrize("sigmas", [3.0, 5.0])
def test_before_a_wall_only_where_the_sight_line_meets_it_for_certain(sigmas: float) -> None:
    """It passes the end of the wall by so many standard deviations inside; 4 count."""
    scene = replace(place((0, -5, 90)), occluders=(Occluder("block", BLOCK),))
    sigma = 0.5 / FOCAL  # of the bearing, on the optical axis
    edge_at = np.arctan2(2.0, 8.0)
    away = np.tan(edge_at - sigmas * sigma / np.cos(edge_at) ** -2)
    xy = np.array([[away * 5.0, 0.0]])
    planes, *_ = planes_of(scene, xy, MapConfig())
    beyond = slack(planes, states([[away * 11.0, 6.0]])).min()
    if sigmas > 4.0:
        assert beyond == pytest.approx(-3.0)  # the near side of the wall is at y = 3
        assert slack(planes, states([[away * 7.9, 2.9]])).min() == pytest.approx(0.1)
    else:
        assert beyond > 0.0


def test_before_the_first_of_two_walls() -> None:
    second = Occluder("second", BLOCK + np.array([0.0, 3.0]))
    scene = replace(place((0, -5, 90)), occluders=(second, Occluder("first", BLOCK)))
    planes, *_ = planes_of(scene, np.array([[0.1, 0.0]]))
    assert slack(planes, states([[0.0, 2.9]])).min() == pytest.approx(0.1)
    assert slack(planes, states([[0.0, 5.0]])).min() == pytest.approx(-2.0)


def test_room_and_clearance_hold_every_state() -> None:
    scene = place((0, -5, 90), half=10.0)
    for clearance in (0.0, 0.5):
        planes, *_ = planes_of(scene, np.array([[0.5, 0.0], [9.0, -5.0]]), MapConfig(wall_clearance=clearance))
        assert slack(planes, states([[0.0, -1.0], [9.4, 0.0]])).min() == pytest.approx(0.6 - clearance)
        assert slack(planes, states([[0.0, -1.0], [10.4, 0.0]])).min() == pytest.approx(-0.4 - clearance)


def test_the_pocket_of_an_l_shaped_room_is_a_wall() -> None:
    scene = replace(place((-5, -5, 45)), room=L_ROOM)
    at = stations(scene, ORIGIN, walls=True)
    assert at.hull is not None
    assert Polygon(at.hull).area == pytest.approx(400.0 - 50.0)  # without the corner that the room does not have
    (pocket,) = at.walls
    assert Polygon(pocket).symmetric_difference(Polygon([(10, 0), (0, 10), (0, 0)])).area < 1e-9
    assert len(at.blockers[0]) == 1
    open_ = stations(scene, ORIGIN, walls=False)
    assert (open_.hull, open_.walls, open_.blockers) == (None, (), ((),))
    moved = stations(scene, np.array([100.0, 7.0]), walls=True)
    assert_allclose(moved.walls[0], pocket - [100.0, 7.0])
    assert_allclose(moved.position, at.position - [100.0, 7.0])


@pytest.mark.parametrize("seed", range(3))
def test_no_half_plane_rules_out_where_a_target_was_seen(seed: int) -> None:
    """Noisy bearings of places in plain view between blocks: every constraint holds at the truth."""
    rng = np.random.default_rng(seed)
    blocks = tuple(
        Occluder(f"b{i}", square(0.8, x, y) @ _turn(0.0)) for i, (x, y) in enumerate([(-4, 2), (0, 4), (3, -1), (6, 5)])
    )
    scene = replace(place((-9, -9, 45), (9, -9, 135), (0, 9.5, -90), range=25.0), occluders=blocks, room=L_ROOM * 1.0)
    free, shapes = [], [Polygon(b.polygon) for b in blocks]
    while len(free) < 150:
        xy = rng.uniform(-10, 10, 2)
        if Polygon(L_ROOM).contains(LineString([xy, xy + 1e-9])) and all(s.distance(_at(xy)) > 0.02 for s in shapes):
            free.append(xy)
    xy = np.array(free)
    hidden = {
        (t, s)
        for t in range(len(xy))
        for s, c in enumerate(scene.cameras)
        if any(LineString([c.ground, xy[t]]).crosses(Polygon(b)) for b in scene.blockers(c.ground))
    }
    planes, _, made = planes_of(scene, xy, noise=rng, blind=hidden)
    assert made.rows.seen.sum() > 60
    assert slack(planes, states(xy)).min() > 0.0


def _at(xy):
    return LineString([xy, xy])


def test_the_convex_hull_is_counter_clockwise() -> None:
    hull = Polygon(convex_hull(L_ROOM[::-1]))
    assert hull.exterior.is_ccw
    assert hull.equals(Polygon(L_ROOM).convex_hull)


def test_a_corner_that_faces_the_camera_rules_out_neither_side() -> None:
    """A reading that meets one face of a block next to its corner; the target may be before the other face."""
    diamond = np.array([[0.0, 2.0], [2.0, 4.0], [0.0, 6.0], [-2.0, 4.0]])
    scene = replace(place((0, -5, 90)), occluders=(Occluder("diamond", diamond),))
    sigma = 0.5 / FOCAL
    planes, *_ = planes_of(scene, np.array([[-sigma * 5.0, 0.0]]))  # reads one standard deviation to the left
    right = 7.0 * sigma * 1.0  # the target is one to the right, before the right face
    assert slack(planes, states([[right, 2.0 + 0.9 * right]])).min() > 0.0
    assert slack(planes, states([[0.0, 2.1]])).min() < 0.0  # but not behind the corner
    notch = np.array([[-2.0, 3.0], [0.0, 4.0], [2.0, 3.0], [2.0, 5.0], [-2.0, 5.0]])
    scene = replace(scene, occluders=(Occluder("notch", notch),))
    planes, *_ = planes_of(scene, np.array([[-sigma * 5.0, 0.0]]))
    assert slack(planes, states([[0.0, 3.9]])).min() > 0.0
