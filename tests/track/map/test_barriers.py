"""What a trajectory cannot pass: views in which a target was not seen, walls and pockets."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from map_scenes import FOCAL, place, record, scans_of
from numpy.testing import assert_allclose
from shapely.geometry import Point, Polygon

from occlog.core.geometry.visibility import in_view
from occlog.records.scene import Occluder
from occlog.track.methods.map.barriers import BORDER, obstacles, view_polygon
from occlog.track.methods.map.config import MapConfig
from occlog.track.methods.map.kernels.paths_around_obstacles import Obstacle
from occlog.track.methods.map.measurements import stations
from occlog.track.methods.map.method import advance, begin

EXTENT = 28.0
L_ROOM = np.array([[-10.0, -10], [10, -10], [10, 0], [0, 0], [0, 10], [-10, 10]])
BLOCK = Occluder("block", np.array([[-1.0, 0.0], [1.0, 0.0], [1.0, 1.0], [-1.0, 1.0]]))


def around(scene, xy, config, **options) -> tuple[Obstacle, ...]:
    made = record(scene, np.arange(len(xy)), xy, **options)
    return obstacles(made, stations(scene, np.zeros(2), walls=config.wall_constraints), config, EXTENT, len(xy))


@pytest.mark.parametrize(("fov", "yaw"), [(0.3, 0.0), (1.2, 2.5), (3.5, -3.0), (6.0, 1.0)])
def test_a_view_polygon_is_inside_the_field_of_view_and_nearly_all_of_it(fov: float, yaw: float) -> None:
    eye, reach = np.array([3.0, -2.0]), 7.0
    corners = view_polygon(eye, yaw, fov, reach)
    view = Polygon(corners)
    assert view.is_valid
    assert view.exterior.is_ccw
    assert 0.99 * 0.5 * fov * reach**2 < view.area < 0.5 * fov * reach**2
    rng = np.random.default_rng(0)
    xy = eye + rng.uniform(-reach, reach, (2000, 2))
    away = xy - eye
    h, d = -np.sin(yaw) * away[:, 0] + np.cos(yaw) * away[:, 1], np.cos(yaw) * away[:, 0] + np.sin(yaw) * away[:, 1]
    angle_ok = np.abs(np.arctan2(h, d)) <= fov / 2
    seen = angle_ok & (np.hypot(h, d) <= reach)
    if fov < np.pi:
        np.testing.assert_array_equal(seen, in_view(h, d, fov, reach))
    inside = np.array([view.contains(Point(p)) for p in xy])
    assert not (inside & ~seen).any()
    assert (inside | ~(angle_ok & (np.hypot(h, d) < 0.99 * reach))).all()


def test_a_view_all_around_is_a_simple_polygon() -> None:
    view = Polygon(view_polygon(np.zeros(2), 0.3, 2 * np.pi, 5.0))
    assert view.is_valid
    assert view.area == pytest.approx(np.pi * 25, rel=0.01)


XY = np.array([[0.0, -5.0], [6.0, -5.0], [0.0, -4.0], [6.0, 3.0]])  # in view, out, in, out


def test_a_view_is_there_when_its_camera_looked_in_vain() -> None:
    scene = place((0, -9, 90), (0, 9, -90), range=6.0)
    assert around(scene, XY, MapConfig()) == ()  # P_D is not known: "not seen" says nothing
    found = around(scene, XY, MapConfig(detection_probability=0.9))
    assert [o.when.tolist() for o in found] == [[False, True, False, True], [True] * 4]
    for o, c in zip(found, scene.cameras, strict=True):
        assert o.price == pytest.approx(-math.log(0.1))
        assert_allclose(o.eye, c.ground)
        assert o.seen_through == ()
        fov = c.fov - 2 * BORDER * max(c.sigma_yaw, c.sigma_read_px / FOCAL)  # a border is left on both sides
        assert_allclose(o.corners, view_polygon(c.ground, c.yaw, fov, 6.0))
        assert sum(Polygon(p).area for p in o.pieces) == pytest.approx(Polygon(o.corners).area)


def test_prices_are_of_each_cameras_own_detection() -> None:
    scene = place((0, -9, 90), (0, 9, -90))
    cameras = (replace(scene.cameras[0], detection=1.0), replace(scene.cameras[1], detection=0.5))
    own = around(replace(scene, cameras=cameras), XY, MapConfig(detection_probability=0.9))
    assert [o.price for o in own] == [math.inf, pytest.approx(math.log(2.0))]
    only = around(replace(scene, cameras=(cameras[0], scene.cameras[1])), XY, MapConfig())
    assert [o.price for o in only] == [math.inf]


def test_far_views_end_beyond_the_room() -> None:
    (view,) = around(place((0, -9, 90)), XY[1:2], MapConfig(detection_probability=0.9))
    assert np.hypot(*(view.corners - view.eye).T).max() == pytest.approx(2 * EXTENT)


def test_arrays_have_no_view() -> None:
    scene = place((0, -9, 90), arrays=((5, 5, 0),))
    made = record(scene, np.arange(4), XY)
    deaf = made._replace(rows=made.rows._replace(seen=np.zeros_like(made.rows.seen)))
    found = obstacles(deaf, stations(scene, np.zeros(2), walls=True), MapConfig(detection_probability=0.9), EXTENT, 4)
    assert len(found) == 1


def test_walls_and_pockets_are_there_always_and_hide_places() -> None:
    scene = replace(place((0, -9, 90)), occluders=(BLOCK,), room=L_ROOM)
    wall, pocket, view = around(scene, XY, MapConfig(detection_probability=0.9))
    for o, polygon in ((wall, BLOCK.polygon), (pocket, np.array([[10.0, 0], [0, 10], [0, 0]]))):
        assert o.seen_through is None
        assert o.when.all()
        assert o.price == math.inf
        assert Polygon(o.corners).exterior.is_ccw
        assert Polygon(o.corners).symmetric_difference(Polygon(polygon)).area < 1e-9
    assert view.seen_through is not None
    assert len(view.seen_through) == 2
    assert Polygon(view.seen_through[0]).covers(Polygon(BLOCK.polygon))  # wider by the border
    assert around(scene, XY, MapConfig(wall_constraints=False)) == ()
    bare = around(scene, XY, MapConfig(wall_constraints=False, detection_probability=0.9))
    assert [o.seen_through for o in bare] == [()]


def walk_past(scene, config, blind=()):
    t = np.arange(0.0, 16.0, 0.5)
    xy = np.column_stack([-7.0 + 14.0 * t / 15.5, np.full(len(t), -2.0)])
    out = advance(begin(scene, config), scans_of(record(scene, t, xy, blind=blind)), last=True)[1]
    assert out.converged
    return xy, out


@pytest.mark.jit
def test_a_track_goes_around_a_block_that_the_shortest_way_cuts() -> None:
    """Seen on both sides of the block only: the smoothest way is through it."""
    pairs = ((-7, -9, 90), (-9, 2, -60), (7, -9, 90), (9, 2, -120))
    scene = place(*pairs, range=9.0, fov=np.radians(40.0))
    block = Occluder("block", np.array([[-0.5, -9.5], [0.5, -9.5], [0.5, -1.0], [-0.5, -1.0]]))
    xy, through = walk_past(replace(scene, occluders=(block,)), MapConfig(wall_constraints=False))
    assert Polygon(block.polygon).intersects(Point(through.xy[np.argmin(np.abs(through.xy[:, 0]))]))
    _, out = walk_past(replace(scene, occluders=(block,)), MapConfig())
    assert "no_path" not in out.fallback
    middle = np.abs(out.xy[:, 0]) < 0.4
    assert (out.xy[middle, 1] > -1.0 - 1e-6).all()
    ends = np.r_[0:3, -3:0]
    assert_allclose(out.xy[ends], xy[ends], atol=0.1)


@pytest.mark.jit
def test_a_track_avoids_a_view_in_which_it_was_not_seen() -> None:
    """A sure camera between the others saw nothing: the target passed behind its back."""
    scene = place((-7, -9, 90), (-9, 2, -60), (7, -9, 90), (9, 2, -120), (0, -3, 90), range=9.0, fov=np.radians(40.0))
    empty = [(t, 4) for t in range(32)]
    xy, away = walk_past(scene, MapConfig(detection_probability=1.0), blind=empty)
    view = Polygon(view_polygon(np.array([0.0, -3.0]), np.pi / 2, 0.9 * np.radians(40.0), 9.0))
    assert any(view.contains(Point(p)) for p in xy)
    assert not any(view.contains(Point(p)) for p in away.xy)
    _, unknown = walk_past(scene, MapConfig(), blind=empty)
    assert any(view.contains(Point(p)) for p in unknown.xy)
