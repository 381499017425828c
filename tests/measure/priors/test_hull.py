"""Visual hulls of hand-worked scenes."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from occlog.core.numerics.assignment import assign
from occlog.measure.priors.hull import (
    CameraCones,
    HullMemory,
    HullRules,
    cones,
    evidence,
    hull,
    hull_camera,
    runs,
    track_polygons,
)
from occlog.records.scene import Camera, Occluder, Scene, camera_rotation

ROOM = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
RULES = HullRules(persist_ns=0, memory_ns=10**9, lost_ns=10**9, hold_ns=0, speed=3.0, reach=0.5)


def camera(name: str, x: float, y: float, yaw_deg: float, fov_deg: float = 100.0, **values) -> Camera:
    return Camera(
        name,
        np.array([x, y, 1.0]),
        camera_rotation(np.radians(yaw_deg), 0.0, 0.0),
        np.array([500.0, 500.0]),
        np.array([320.0, 240.0]),
        fov=np.radians(fov_deg),
        **values,
    )


CAMERAS = (camera("south", 5, 0, 90), camera("west", 0, 5, 0), camera("corner", 0, 0, 45), camera("far", 10, 10, 225))


def observation(cam: Camera, people, scene: Scene, width: float = 0.4) -> CameraCones:
    """What a camera sees of people who are discs."""
    view = hull_camera(cam, scene)
    rows = []
    for p in people:
        away = np.asarray(p) - cam.ground
        rows.append([np.arctan2(away[1], away[0]), 2 * np.arcsin(0.5 * width / np.hypot(*away))])
    return CameraCones(view.visible, cones(view, np.array(rows).reshape(-1, 2)))


def polygons(names, people, missing=(), misses=0, scene=None):
    scene = scene or Scene(cameras=CAMERAS, room=ROOM)
    detections = [observation(scene.camera(n), [p for p in people if (n, p) not in missing], scene) for n in names]
    return hull(detections, ROOM, 2, misses, 1e-3)


def holds(found, point) -> bool:
    return any(p.shape.contains(shapely.Point(point)) for p in found)


# South sees them at x = 3 and 7 of its middle line, west at y = 3 and 7: a square of crossings.
PEOPLE = ((4.0, 6.0), (7.0, 4.0))


def test_two_cameras_two_people_give_two_phantoms() -> None:
    found = polygons(("south", "west"), PEOPLE)
    assert len(found) == 4
    assert all(holds(found, p) for p in PEOPLE)
    assert evidence(found) == [False] * 4  # nothing tells phantoms from people


def test_crossings_are_where_the_lines_meet() -> None:
    """A phantom is where the line from one camera to one person meets that of the other camera to the other."""
    found = polygons(("south", "west"), PEOPLE)
    for a, b in ((PEOPLE[0], PEOPLE[1]), (PEOPLE[1], PEOPLE[0])):
        # (5, 0) + s (a - (5, 0)) = (0, 5) + t (b - (0, 5))
        u, v = np.array(a) - [5, 0], np.array(b) - [0, 5]
        s, _ = np.linalg.solve(np.column_stack([u, -v]), [-5.0, 5.0])
        assert holds(found, np.array([5, 0]) + s * u)


def test_third_camera_removes_phantoms() -> None:
    found = polygons(("south", "west", "corner"), PEOPLE)
    assert len(found) == 2
    assert all(holds(found, p) for p in PEOPLE)
    assert evidence(found) == [True, True]
    assert all(len(p.runs) == 3 and p.missed == 0 for p in found)


def test_missed_blob_needs_one_of_n_less() -> None:
    missing = {("corner", PEOPLE[0])}
    names = ("south", "west", "corner", "far")
    strict = polygons(names, PEOPLE, missing)
    assert [holds(strict, p) for p in PEOPLE] == [False, True]
    found = polygons(names, PEOPLE, missing, misses=1)
    assert [holds(found, p) for p in PEOPLE] == [True, True]
    assert len(found) == 2
    assert sorted(p.missed for p in found) == [0, 1]


def test_camera_that_cannot_see_a_place_says_nothing_about_it() -> None:
    """Behind a wall, beyond its range and next to its field of view a camera does not count."""
    wall = Occluder("wall", np.array([[0.5, 3.0], [3.0, 3.0], [3.0, 3.2], [0.5, 3.2]]))
    for corner in (
        camera("corner", 0, 0, 45),
        camera("corner", 0, 0, 45, range=3.0),
        camera("corner", 0, 0, 0, fov_deg=60.0),
    ):
        scene = Scene(cameras=(*CAMERAS[:2], corner), room=ROOM, occluders=(wall,) if corner.range > 9 else ())
        person = (3.0, 6.5)  # behind the wall as seen from the corner
        detections = [observation(scene.camera(n), [person], scene) for n in ("south", "west")]
        view = hull_camera(corner, scene)
        assert not view.visible.contains(shapely.Point(person))
        found = hull([*detections, CameraCones(view.visible, [])], ROOM, 2, 0, 1e-3)
        assert len(found) == 1
        assert holds(found, person)


def test_no_one_and_one_camera() -> None:
    assert polygons(("south", "west"), ()) == []
    assert polygons(("south",), PEOPLE) == []
    assert hull([], ROOM, 2, 1, 1e-3) == []


def test_runs_of_boxes_are_their_azimuths() -> None:
    cam = camera("c", 0, 0, 30)
    ((centre, width),) = runs(np.array([[220.0, 100.0, 200.0, 280.0]]), cam, 0.01)
    half = np.arctan(100.0 / 500.0)
    assert centre == pytest.approx(np.radians(30.0), abs=1e-12)
    assert width == pytest.approx(2 * (half + 0.01), abs=1e-12)


def test_runs_that_overlap_are_one() -> None:
    view = hull_camera(CAMERAS[0], Scene(cameras=CAMERAS, room=ROOM))
    assert len(cones(view, np.array([[1.5, 0.1], [1.58, 0.1], [2.0, 0.1]]))) == 2
    assert cones(view, np.empty((0, 2))) == []


def test_visible_part_against_sampling() -> None:
    """The visible polygon agrees with the kernels of the filter's visibility at random places."""
    from occlog.core.geometry.visibility import make_sensors, seen_from

    walls = (Occluder("pillar", np.array([[4.0, 4.0], [6.0, 4.0], [6.0, 6.0], [4.0, 6.0]])),)
    rng = np.random.default_rng(3)
    for n in range(20):
        cam = camera(
            "c", *rng.uniform(0, 3, 2), rng.uniform(-180, 180), rng.uniform(20, 350), range=rng.choice([4.0, np.inf])
        )
        scene = Scene(cameras=(cam,), room=ROOM, occluders=walls)
        xy = rng.uniform(0, 10, (500, 2))
        sensors = make_sensors(
            cam.ground[None],
            np.array([cam.yaw]),
            np.array([cam.fov]),
            np.array([cam.range]),
            [scene.blockers(cam.ground)],
        )
        # With a field of view of 180 degrees and more the filter's camera still sees nothing behind it.
        ahead = (xy - cam.ground) @ [np.cos(cam.yaw), np.sin(cam.yaw)] > 0
        inside = np.array([p.within(walls_of(walls)) for p in shapely.points(xy)])
        want = seen_from(np.ascontiguousarray(xy), 0, sensors)
        got = shapely.contains_xy(hull_camera(cam, scene).visible, xy)
        check = ahead & ~inside
        assert np.mean(got[check] != want[check]) < 0.005, n  # the range is a polygon, not a circle


def walls_of(walls):
    return shapely.union_all([shapely.Polygon(w.polygon) for w in walls])


def test_phantoms_vanish_when_people_move() -> None:
    """Two cameras: a third sees them for a while; what was sure then stays so, and phantoms stay out."""
    memory, seen = HullMemory(), []
    rules = RULES._replace(persist_ns=150_000_000, memory_ns=5 * 10**9)
    for step in range(12):
        people = tuple((x + 0.05 * step, y) for x, y in PEOPLE)
        names = ("south", "west", "corner") if step < 4 else ("south", "west")
        found = polygons(names, people)
        memory, given = track_polygons(memory, step * 100_000_000, found, rules)
        seen.append([s.identity for s in given])
        if step >= 2:
            assert all(holds([s.polygon for s in given], p) for p in people)
            assert len(given) == 2
    assert seen[:2] == [[], []]
    assert all(s == seen[2] for s in seen[2:])


def test_identities_stay_through_a_gap() -> None:
    memory, names = HullMemory(), []
    for step, there in enumerate([True, True, False, False, True]):
        found = polygons(("south", "west"), (PEOPLE[0],)) if there else []
        memory, seen = track_polygons(memory, step * 10**8, found, RULES._replace(hold_ns=10**8))
        names.append([s.identity for s in seen])
    assert names == [[0], [0], [0], [], [0]]  # held for one time
    _, seen = track_polygons(memory, 10**11, polygons(("south", "west"), (PEOPLE[0],)), RULES)
    assert [s.identity for s in seen] == [1]


def test_phantoms_cannot_be_distinguished_without_more_cameras() -> None:
    """All four crossings stay: any two of them may be the people."""
    _, seen = track_polygons(HullMemory(), 0, polygons(("south", "west"), PEOPLE), RULES)
    assert len(seen) == 4


def test_assignment_prefers_more_pairs_within_the_gate() -> None:
    rows, columns = assign(np.array([[0.1, 0.9], [0.2, 5.0]]), 1.0)
    assert list(zip(rows, columns, strict=True)) == [(0, 1), (1, 0)]
    rows, _ = assign(np.array([[2.0]]), 1.0)
    assert len(rows) == 0
    assert len(assign(np.empty((0, 3)), 1.0)[0]) == 0


def test_assignment_against_all_permutations() -> None:
    from itertools import permutations

    for seed in range(30):
        cost = np.random.default_rng(seed).uniform(0, 2, (4, 4))
        rows, columns = assign(cost, 1.0)
        best = max(
            (
                (sum(cost[i, p[i]] <= 1 for i in range(4)), -sum(c for i in range(4) if (c := cost[i, p[i]]) <= 1))
                for p in permutations(range(4))
            ),
        )
        assert (len(rows), -cost[rows, columns].sum()) == pytest.approx(best)
