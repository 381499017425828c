"""Where things are in a rendered image, against `Camera.project` and sampled surfaces."""

from functools import cache

import numpy as np
import pytest

from occlog.core.geometry.camera import rotation_from_angles
from occlog.records.scene import Camera, Occluder, Scene
from occlog.simulate.render.body import Poses, clothes_of, dress, solids
from occlog.simulate.render.frame import around_ellipsoids, canvas, draw, ideal_limits, pixel_boxes

ROOM = np.array([[0.0, 0.0], [8.0, 0.0], [8.0, 6.0], [0.0, 6.0]])
PILLAR = np.array([[4.0, 2.0], [4.5, 2.0], [4.5, 2.5], [4.0, 2.5]])
SCENE = Scene(room=ROOM, occluders=(Occluder("pillar", PILLAR, 1.5),), room_height=3.0)
NOISE = np.zeros(4000, dtype=np.float32)

ANGLES = [(40.0, 0.0, 0.0), (35.0, -20.0, 7.0), (50.0, 15.0, -25.0)]
LENSES = [np.zeros(5), np.array([-0.25, 0.06, 0.002, -0.001, 0.0])]


def camera(angles=(40.0, 0.0, 0.0), lens=None, size=(240, 180), focal=150.0):
    return Camera(
        "c",
        np.array([0.2, 0.3, 1.5]),
        rotation_from_angles(*np.radians(angles)),
        np.array([focal, focal * 1.02]),
        np.array([0.5 * size[0] - 3.0, 0.5 * size[1] + 2.0]),
        image_size=size,
        distortion=np.zeros(5) if lens is None else lens,
    )


VIEWS = [camera(angles, lens) for angles in ANGLES for lens in LENSES]


def person(seed=0, target=True):
    return dress(0, target, np.random.default_rng(seed))


def rows(*places, velocity=(0.0, 0.0), phase=0.0):
    return np.array([[x, y, *velocity, phase] for x, y in places])


@cache
def sheet(number):
    return canvas(SCENE, VIEWS[number], 1.0, NOISE)


def shot(cam, places, **values):
    clothes = clothes_of([person(i) for i in range(len(places))])
    on = sheet(VIEWS.index(cam)) if cam in VIEWS else canvas(SCENE, cam, 1.0, NOISE)
    return draw(on, rows(*places, **values), clothes, 1.0, (0.0, 0.0), False, np.random.default_rng(0))


@pytest.mark.jit
@pytest.mark.parametrize("cam", VIEWS)
def test_depths_of_the_empty_room_are_those_of_projected_points(cam):
    """Points on floor, walls and pillar: the depth at their pixel is theirs, or less where something hides them."""
    rng = np.random.default_rng(1)
    depth = sheet(VIEWS.index(cam)).empty.depth.mean(axis=2)
    u, v = rng.uniform(0.02, 0.98, (2, 3000))
    points = np.concatenate(
        [
            np.column_stack([8 * u, 6 * v, 0 * u])[:1000],
            np.column_stack([0 * u + 8.0, 6 * u, 3 * v])[:1000],
            np.column_stack([8 * u, 0 * u + 6.0, 3 * v])[:1000],
            np.column_stack([4 + 0.5 * u, 0 * u + 2.0, 1.5 * v])[:500],
        ]
    )
    pixels, local = cam.project(points), (points - cam.position) @ cam.rotation
    inside = (pixels > 0).all(axis=1) & (pixels < [239, 179]).all(axis=1)
    column, row = np.rint(pixels[inside]).astype(int).T
    got, want = depth[row, column], local[inside, 2]
    slope = 0.03 * want + 0.05  # a pixel covers a stretch of a slanted floor
    assert inside.sum() > 300
    nearest = sheet(VIEWS.index(cam)).empty.depth.min(axis=2)[row, column]
    assert np.mean(nearest < want + slope) > 0.995  # a point on an edge may round to a pixel next to it
    assert np.mean(np.abs(got - want) < slope) > 0.8


@pytest.mark.jit
@pytest.mark.parametrize(
    ("cam", "place"), [(cam, [(3.0, 3.0), (5.0, 3.4), (1.5, 1.2)][k % 3]) for k, cam in enumerate(VIEWS)]
)
def test_a_body_reaches_as_far_as_its_projected_surface(cam, place):
    """The pixels that a body covers are those of densely sampled surface points, to one pixel."""
    drawn = shot(cam, [place], velocity=(0.7, -0.4), phase=1.0)
    velocity = np.array([0.7, -0.4])
    pose = Poses(
        np.array([place]),
        velocity[None] / np.hypot(*velocity),
        np.array([1.0]),
        np.array([0.5 * np.hypot(*velocity) / 1.2]),
    )
    parts = solids(pose, clothes_of([person(0)]), 1.0)
    a, z = np.meshgrid(np.linspace(0, 2 * np.pi, 120), np.linspace(-1, 1, 121))
    sphere = np.stack([np.sqrt(1 - z**2) * np.cos(a), np.sqrt(1 - z**2) * np.sin(a), z], axis=-1).reshape(-1, 3)
    surface = [c + np.linalg.solve(m, sphere.T).T for c, m in zip(parts.centre, parts.axes, strict=True)]
    pixels = cam.project(np.concatenate(surface))
    inside = (pixels > -0.5).all(axis=1) & (pixels < [239.5, 179.5]).all(axis=1)
    low, high = pixels[inside].min(axis=0), pixels[inside].max(axis=0)
    assert inside.any()
    assert drawn.extent[0, :4] == pytest.approx([*low, *high], abs=1.0)


@pytest.mark.jit
@pytest.mark.parametrize("place", [(3.0, 2.0), (6.0, 5.0), (2.0, 4.5)])
def test_the_axis_of_a_standing_body_is_in_the_middle_of_its_pixels(place):
    """Facing the camera a body is symmetric: the mean column of its head and trunk is that of its axis."""
    yaw = np.degrees(np.arctan2(place[1] - 0.3, place[0] - 0.2))
    cam = camera((yaw, 0.0, 0.0), focal=195.0)
    toward = -np.array([np.cos(np.radians(yaw)), np.sin(np.radians(yaw))]) * 1e-6
    sheet = canvas(SCENE, cam, 1.0, NOISE)
    clothes, still = clothes_of([person(0)]), rows(place, velocity=tuple(toward))
    image = draw(sheet, still, clothes, 1.0, (0.0, 0.0), False, np.random.default_rng(0)).image
    empty = sheet.empty.colour
    changed = np.abs(image.astype(float) - np.floor(np.clip(empty, 0, 255) + 0.5)).max(axis=2) > 3
    axis = cam.project(np.array([[*place, z] for z in (1.1, 1.3, 1.6)]))
    for column, row in axis:
        line = np.flatnonzero(changed[round(row)])
        assert abs(line.mean() - column) < 1.0
    feet, head = cam.project(np.array([[*place, 0.0], [*place, 1.76 * person(0).stature]]))
    tall = np.flatnonzero(changed.any(axis=1))
    assert abs(tall[-1] - min(feet[1], 179)) < 3.0  # shoes stand in front of the axis
    assert abs(tall[0] - head[1]) < 2.0


@pytest.mark.jit
def test_nearer_bodies_hide_farther_ones_in_any_order():
    cam = camera((45.0, 0.0, 0.0))
    line = [(1.7, 1.8), (3.2, 3.3)]
    a, b = shot(cam, line), shot(cam, line[::-1])
    assert a.visible[0, 4] == a.extent[0, 4]
    assert a.visible[1, 4] < 0.3 * a.extent[1, 4]
    assert b.visible[1, 4] == b.extent[1, 4]
    alone = shot(cam, line[1:])
    assert alone.visible[0, 4] == alone.extent[0, 4]
    assert (alone.extent[0] == b.extent[0]).all()


@pytest.mark.jit
def test_pillars_hide_up_to_their_height():
    yaw = np.degrees(np.arctan2(1.95, 4.05))
    cam = camera((yaw, 0.0, 0.0))
    behind = shot(cam, [(4.25 + 1.0, 2.25 + 0.47)])
    rows_seen = behind.visible[0, [1, 3]]
    assert 0 < behind.visible[0, 4] < 0.5 * behind.extent[0, 4]
    assert rows_seen[0] == behind.extent[0, 1]  # the head is above the pillar of 1.5 m
    before = shot(cam, [(3.0, 0.3 + 1.95 / 4.05 * 2.8)])
    assert before.visible[0, 4] == before.extent[0, 4]


@pytest.mark.jit
def test_the_visible_part_is_what_changes_in_the_image():
    cam = camera((45.0, 0.0, 0.0))
    empty, drawn = shot(cam, [(7.9, 0.1)]).image, shot(cam, [(3.0, 2.7)])
    changed = np.argwhere((empty != drawn.image).any(axis=2))
    (top, left), (bottom, right) = changed.min(axis=0), changed.max(axis=0)
    assert drawn.visible[0, :4].tolist() == [left, top, right, bottom]
    assert abs(drawn.visible[0, 4] / 4 - len(changed)) < 0.15 * len(changed)


@pytest.mark.parametrize("lens", LENSES)
def test_search_boxes_hold_every_sight_line_that_meets_an_ellipsoid(lens):
    """Independent form: a point is in an ellipsoid's shadow if the nearest point of its sight line is inside."""
    cam, rng = camera((40.0, -10.0, 5.0), lens, (64, 48), 40.0), np.random.default_rng(4)
    pixels = np.stack(np.meshgrid(np.arange(64.0), np.arange(48.0)), axis=-1).reshape(-1, 2)
    rays = cam.rays(pixels)
    for _ in range(30):
        turn, _ = np.linalg.qr(rng.standard_normal((3, 3)))
        half = rng.uniform(0.1, 0.8, 3)
        centre = cam.position + cam.rotation @ np.array([*rng.uniform(-3, 3, 2), rng.uniform(-1, 5)])
        axes = turn / half[:, None]
        box = pixel_boxes(cam, ideal_limits(cam), around_ellipsoids(centre[None], axes[None], half[None]))[0]
        u, v = axes @ (cam.position - centre), rays @ axes.T
        t = np.maximum(0, -(v @ u) / np.sum(v * v, axis=1))
        hit = np.sum((u + t[:, None] * v) ** 2, axis=1) < 1
        inside = ((pixels >= box[:2]) & (pixels < box[2:])).all(axis=1)
        assert (inside | ~hit).all()
