"""The video of balls: outlines, shares and ways against sampled surfaces and plain forms."""

from dataclasses import replace

import numpy as np
import pytest

from occlog.core.image import quadratic
from occlog.errors import InputError
from occlog.settings import SettingError, configure
from occlog.simulate.balls.config import BallsConfig
from occlog.simulate.balls.motion import BallPaths, ball_box, ball_cameras, ball_ellipses, ball_paths
from occlog.simulate.balls.video import FOOTBALL, football_faces, render_balls

SMALL = BallsConfig(frames=3, width=64, height=48, radius=6.0, balls=3, background_clutter=2)
PLAIN = replace(SMALL, noise=0.0, colour_noise=0.0, background_clutter=0)


def squared_distances(e, points):
    a, b, c = quadratic(e[2], e[3], e[4])
    dx, dy = (points - e[:2]).T
    return a * dx * dx + 2 * b * dx * dy + c * dy * dy


def sphere(centre, radius, n=60_000):
    p = np.random.default_rng(0).standard_normal((n, 3))
    return centre + radius * p / np.linalg.norm(p, axis=1, keepdims=True)


def at(config, *centres):
    positions = np.array([centres], dtype=float)
    return BallPaths(positions, np.broadcast_to(np.eye(3), (1, len(centres), 3, 3)))


@pytest.mark.parametrize("distance", [1e6, 900.0, 660.0])
@pytest.mark.parametrize("view", [0, 1, 2])
def test_outlines_hold_the_pixels_of_a_ball_and_no_less(distance, view):
    camera = ball_cameras(BallsConfig(views=3, distance=distance))[view]
    for centre in ([0.0, 0, 120], [90.0, -60, 200], [-100.0, 100, 30]):
        e = ball_ellipses(camera, np.array(centre), 22.0)
        q = squared_distances(e, camera.project(sphere(np.array(centre), 22.0)))
        assert 0.998 < q.max() < 1 + 1e-5  # 60000 points leave gaps of a thousandth at the rim


def test_far_views_have_circles_of_one_size_and_a_right_angle_keeps_the_row():
    config = BallsConfig()
    centres = ball_paths(config, 5).centres
    first, second = (ball_ellipses(c, centres, config.radius) for c in ball_cameras(config))
    for e in (first, second):
        np.testing.assert_allclose(e[..., 2:4], 22.0, atol=0.01)
    np.testing.assert_allclose(first[..., 1], second[..., 1], atol=0.03)
    np.testing.assert_allclose(first[..., 0], 159.5 - centres[..., 1], atol=0.03)  # points along +x
    np.testing.assert_allclose(second[..., 0], 159.5 + centres[..., 0], atol=0.03)  # points along +y


@pytest.mark.parametrize(("views", "distance"), [(2, 1e6), (6, 1e6), (6, 800.0)])
def test_balls_stay_in_the_box_and_in_every_image(views, distance):
    config = BallsConfig(views=views, distance=distance, radius=12.0)
    centres = ball_paths(config, 1).centres
    box = ball_box(config)
    assert (np.abs(centres - [0, 0, 120]) <= box - 12.0 + 1e-9).all()
    assert np.abs(centres - [0, 0, 120]).max(axis=(0, 1)) == pytest.approx(box - 12.0, rel=0.05)
    for camera in ball_cameras(config):
        e = ball_ellipses(camera, centres, 12.0)
        reach = np.hypot(e[..., 2] * np.cos(e[..., 4]), e[..., 3] * np.sin(e[..., 4]))
        assert (e[..., 0] - reach).min() > -0.7
        assert (e[..., 0] + reach).max() < 319.7
    if views == 2:
        np.testing.assert_array_equal(box, [160, 160, 120])


def test_ways_are_straight_but_for_the_walls():
    config = BallsConfig(frames=300, ball_speed=4.0)
    centres = ball_paths(config, 3).centres
    step = np.diff(centres, axis=0)
    place, v = centres[0] - [0, 0, 120], step[0].copy()
    reach = ball_box(config) - 22.0
    for t in range(1, 300):
        place += v
        over = np.abs(place) - reach
        v = np.where(over > 0, -v, v)
        place = np.where(over > 0, np.sign(place) * (reach - over), place)
        np.testing.assert_allclose(place, centres[t] - [0, 0, 120], atol=1e-8)
    speed = np.linalg.norm(step[0], axis=1)
    assert ((speed > 2.0) & (speed < 6.0)).all()


@pytest.mark.parametrize("motion", ["walk", "manoeuvre"])
def test_motions_of_one_seed_start_alike_stay_in_the_box_and_step_as_stated(motion):
    config = BallsConfig(frames=400, ball_motion=motion)
    paths, straight = ball_paths(config, 3), ball_paths(replace(config, ball_motion="straight"), 3)
    np.testing.assert_array_equal(paths.centres[0], straight.centres[0])
    np.testing.assert_array_equal(paths.turns, straight.turns)
    reach = ball_box(config) - 22.0
    assert (np.abs(paths.centres - [0, 0, 120]) <= reach + 1e-9).all()
    steps = np.diff(paths.centres, axis=0)
    if motion == "walk":
        assert steps.std() == pytest.approx(3.0, rel=0.05)
        return
    speed = np.linalg.norm(steps, axis=-1)
    assert 0.999 * 6.0 < speed.max() <= 6.0 + 1e-9
    # Where neither the walls nor the limit of the speed changes them, velocities change by 1 px a frame along each axis
    free = (speed[1:] < 4.0) & (speed[:-1] < 4.0) & (np.abs(paths.centres[1:-1] - [0, 0, 120]) < reach - 7.0).all(-1)
    assert free.sum() > 200
    assert np.diff(steps, axis=0)[free].std() == pytest.approx(1.0, rel=0.1)


def test_a_video_of_one_frame_has_every_motion():
    for motion in ("straight", "walk", "manoeuvre"):
        assert ball_paths(BallsConfig(frames=1, ball_motion=motion), 1).centres.shape == (1, 6, 3)


def test_balls_that_collide_fly_straight_on():
    with pytest.raises(SettingError, match="straight for balls that collide"):
        configure(BallsConfig(), {"collide": True, "ball_motion": "walk"})


def test_balls_that_collide_keep_their_energy_and_stay_apart():
    config = BallsConfig(frames=400, collide=True, ball_speed=4.0)
    centres = ball_paths(config, 2).centres
    gaps = np.linalg.norm(centres[:, :, None] - centres[:, None], axis=-1)[:, *np.triu_indices(6, 1)]
    assert gaps.min() > 0.9 * 44.0
    free = ball_paths(replace(config, collide=False), 2).centres
    apart = np.linalg.norm(free[:, :, None] - free[:, None], axis=-1)[:, *np.triu_indices(6, 1)]
    assert apart.min() < 0.9 * 44.0  # the same balls would have met
    turned = np.linalg.norm(np.diff(centres, n=2, axis=0), axis=-1) > 1e-9
    straight = ~turned.any(axis=1)  # a frame in which no one met anything
    energy = (np.diff(centres, axis=0) ** 2).sum(axis=(1, 2))[1:][straight]
    assert len(energy) > 50
    np.testing.assert_allclose(energy, energy[0], rtol=1e-9)


def test_the_first_frame_shows_every_ball():
    for seed in range(12):
        frame = next(render_balls(replace(SMALL, frames=1, radius=5.0), seed))
        assert (frame.share == 1.0).all()


def test_share_of_a_ball_half_behind_another_is_the_area_of_the_lens():
    """View 1 points along +x: balls at the same height, one behind; d = radius between centres."""
    config = replace(PLAIN, width=120, height=80, radius=20.0)
    behind, front = (10.0, -10.0, 40.0), (-10.0, 10.0, 40.0)
    frame = next(render_balls(config, 1, paths=at(config, behind, front)))
    lens = (2 * np.pi / 3 - np.sqrt(3) / 2) / np.pi  # of two unit circles at distance 1, over one of them
    assert frame.share[0] == pytest.approx([1 - lens, 1.0], abs=0.01)  # 4 lines a pixel: 0.5 % at the rim
    assert frame.share[1] == pytest.approx([1.0, 1 - lens], abs=0.01)  # view 2 points along +y: y = -10 is nearer
    swapped = next(render_balls(config, 1, paths=at(config, front, behind)))
    assert np.array_equal(swapped.share, frame.share[:, ::-1])
    assert all(np.array_equal(a, b) for a, b in zip(swapped.images, frame.images, strict=True))


@pytest.mark.parametrize("distance", [1e6, 300.0])
def test_the_image_differs_from_the_background_where_the_ball_is(distance):
    config = replace(PLAIN, width=80, height=60, radius=9.0, distance=distance)
    far_off = next(render_balls(config, 1, paths=at(config, (0.0, 0.0, 9000.0))))
    frame = next(render_balls(config, 1, paths=at(config, (5.0, -8.0, 33.0))))
    assert (far_off.share == 0).all()
    for image, empty, e in zip(frame.images, far_off.images, frame.ellipses[:, 0], strict=True):
        y, x = np.nonzero((image != empty).any(axis=2))
        q = squared_distances(e, np.column_stack([x, y]))
        rim = 2.0 / e[3]  # a pixel at the rim is mixed
        assert q.max() < (1 + rim) ** 2
        inside = np.stack(np.meshgrid(np.arange(80), np.arange(60)), axis=-1).reshape(-1, 2)
        assert len(x) >= (squared_distances(e, inside) < (1 - rim) ** 2).sum()
        np.testing.assert_allclose([x.mean(), y.mean()], e[:2], atol=0.3)


def test_balls_over_the_edge_and_outside_are_cut():
    config = replace(PLAIN, width=40, height=40)
    frame = next(render_balls(config, 1, paths=at(config, (0.0, 20.0, 20.0), (0.0, 500.0, 20.0))))
    assert frame.share[0, 0] == 1.0  # of the part in the image
    assert frame.share[0, 1] == 0.0
    assert np.isfinite(frame.ellipses).all()


@pytest.mark.jit
def test_frames_do_not_depend_on_the_number_of_workers():
    config = replace(BallsConfig(), frames=40, views=3, radius=15.0)
    for one, two in zip(render_balls(config, 7), render_balls(config, 7, workers=3), strict=True):
        assert one.frame == two.frame
        assert all(np.array_equal(a, b) for a, b in zip(one.images, two.images, strict=True))
        assert np.array_equal(one.share, two.share)


def test_noise_and_seeds():
    one, two = list(render_balls(replace(SMALL, frames=2), 1)), list(render_balls(replace(SMALL, frames=2), 2))
    assert not np.array_equal(one[0].images[0], two[0].images[0])
    still = replace(SMALL, frames=2, ball_speed=0.0, spin=0.0)
    quiet = next(render_balls(replace(still, noise=0.0, colour_noise=0.0), 1))
    noisy = list(render_balls(still, 1))
    assert not np.array_equal(noisy[0].images[0], noisy[1].images[0])
    rest = noisy[0].images[0].astype(float) - quiet.images[0]
    # Variance of common and single noise and of rounding; 9216 values share noise by threes: error bar 3 %
    assert rest.std() == pytest.approx(np.sqrt(1.5**2 + 1 + 1 / 6), rel=0.06)


def test_panels_folded_into_one_octant_are_those_of_the_whole_ball():
    whole = football_faces()
    np.testing.assert_allclose(np.linalg.norm(whole, axis=1), [1 / 2.32744] * 12 + [1 / 2.26728] * 20)
    points = sphere(np.zeros(3), 1.0, 20_000)
    every = points @ whole.T
    folded = np.abs(points) @ (FOOTBALL.faces / 2.47802).T
    np.testing.assert_allclose(np.sort(folded)[:, -2:], np.sort(every)[:, -2:], atol=1e-12)
    assert np.array_equal(folded.argmax(axis=1) < FOOTBALL.pentagons, every.argmax(axis=1) < 12)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"radius": 200.0}, "does not fit"),
        ({"balls": 60}, "no room for 60"),
        ({"frames": 0}, "frames is 0"),
        ({"ball_speed": -1.0}, "ball_speed is -1"),
        ({"radius": float("nan")}, "radius is nan"),
        ({"views": 0}, "views is 0"),
        ({"views": 7}, "views is 7"),
        ({"distance": 300.0}, "outside the box"),
    ],
)
def test_what_cannot_be_is_reported(change, says):
    with pytest.raises(InputError, match=says):
        ball_paths(replace(BallsConfig(), **change), 1)
