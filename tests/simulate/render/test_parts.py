"""Bodies, gait, clothes and surfaces of the rendered room."""

import colorsys

import numpy as np
import pytest

from occlog.core.numerics.interpolate import TimeGrid
from occlog.core.numerics.seeds import RandomStream, generator
from occlog.simulate.render import surfaces as texture
from occlog.simulate.render.body import FULL_SWING, SHIRT, SIDES, STRIDE, Poses, clothes_of, dress, solids, walking
from occlog.simulate.render.kernel import cloth
from occlog.simulate.render.surfaces import in_shadow, lamps, light_at


def standing(phase=0.0, swing=0.0, heading=(1.0, 0.0)):
    return Poses(np.zeros((1, 2)), np.array([heading]), np.array([phase]), np.array([swing]))


def reach(parts):
    """Least and greatest coordinate of each ellipsoid along x, y, z: c +- |columns of A^-1|."""
    spread = np.linalg.norm(np.linalg.inv(parts.axes), axis=2)
    return parts.centre - spread, parts.centre + spread


@pytest.mark.parametrize("phase", np.linspace(0, 2 * np.pi, 9))
@pytest.mark.parametrize("swing", [0.0, FULL_SWING])
def test_feet_touch_the_floor_and_heads_are_at_the_stature(phase, swing):
    worn = clothes_of([dress(0, True, np.random.default_rng(1))])
    low, high = reach(solids(standing(phase, swing), worn, 1.0))
    assert low[:, 2].min() == pytest.approx(0.0, abs=0.02)
    tall = high[:, 2].max() / (1.75 * worn.stature[0])
    assert 0.9 < tall <= 1.02
    assert high[:, 1].max() - low[:, 1].min() < 0.65  # about half a metre wide


def test_axes_are_orthogonal_with_the_stated_half_lengths_and_scale():
    worn = clothes_of([dress(0, True, np.random.default_rng(1))])
    small, large = solids(standing(0.7, 0.4), worn, 1.0), solids(standing(0.7, 0.4), worn, 3.0)
    gram = np.einsum("pij,pkj->pik", small.axes, small.axes)
    assert gram == pytest.approx(np.eye(3) / small.half[:, None, :] ** 2, abs=1e-9)
    assert large.centre == pytest.approx(3 * small.centre)
    assert large.half == pytest.approx(3 * small.half)


def test_a_body_turns_with_its_heading():
    worn = clothes_of([dress(0, True, np.random.default_rng(1))])
    east, north = solids(standing(1.0, 0.5), worn, 1.0), solids(standing(1.0, 0.5, (0.0, 1.0)), worn, 1.0)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert north.centre == pytest.approx(east.centre @ turn.T)


def walker(steps, start=0):
    t = np.arange(start, start + steps) * 100_000_000
    xyz = np.full((steps, 1, 3), np.nan)
    xyz[:, 0, 0] = 0.12 * np.arange(start, start + steps)
    xyz[:, 0, 1] = 1.0
    return TimeGrid(t, np.array([3]), np.array([True]), xyz)


def test_a_walker_faces_its_way_and_takes_a_stride_every_two_steps():
    (grid,) = walking([walker(101)], 1.0)
    assert grid.xyz[:, 0, 2] == pytest.approx(1.2, abs=1e-5)
    assert grid.xyz[:, 0, 3] == pytest.approx(0.0, abs=1e-9)
    cycles = (grid.xyz[-1, 0, 4] - grid.xyz[0, 0, 4]) / (2 * np.pi)
    assert cycles == pytest.approx(12.0 / STRIDE, rel=1e-5)


def test_gait_goes_on_across_chunks():
    (whole,) = walking([walker(30)], 1.0)
    parts = list(walking([walker(11), walker(19, 11)], 1.0))
    assert np.concatenate([p.xyz for p in parts]) == pytest.approx(whole.xyz)


def test_a_noisy_path_does_not_turn_the_body():
    grid = walker(200)
    grid.xyz[:, 0, :2] += 0.02 * np.random.default_rng(0).standard_normal((200, 2))
    (walked,) = walking([grid], 1.0)
    angle = np.arctan2(walked.xyz[20:, 0, 3], walked.xyz[20:, 0, 2])
    assert np.abs(angle).max() < 0.5
    raw = np.diff(grid.xyz[:, 0, :2], axis=0)
    assert np.abs(np.arctan2(raw[:, 1], raw[:, 0])).max() > 0.6


def test_targets_wear_warm_colours_and_others_do_not():
    def hue(observation):
        b, g, r = observation.first[SHIRT] / 255
        h, s, _ = colorsys.rgb_to_hsv(r, g, b)
        return h, s

    for seed in range(20):
        warm, vivid = hue(dress(seed % 4, True, generator(seed, RandomStream.RENDER_CLOTHES, 0)))
        cool, pale = hue(dress(-1, False, generator(seed, RandomStream.RENDER_CLOTHES, 9)))
        assert vivid > 0.8
        assert warm < 0.32 or warm > 0.85
        assert 0.39 < cool < 0.69
        assert pale < 0.8
    shirts = [hue(dress(k, True, generator(0, RandomStream.RENDER_CLOTHES, k)))[0] for k in range(4)]
    assert min(abs(a - b) for i, a in enumerate(shirts) for b in shirts[:i]) > 0.1


def test_noise_of_surfaces_is_smooth_bounded_and_fixed():
    x = np.linspace(-3, 3, 4001)
    y = 0.3 + 0 * x
    values = texture.smooth_noise(x, y, 0.5, 7)
    assert (values == texture.smooth_noise(x, y, 0.5, 7)).all()
    assert np.abs(values).max() <= 1.0
    assert values.std() > 0.2
    assert np.abs(np.diff(values)).max() < 0.02
    i = np.arange(20_000)
    uniform = texture.hashed(i, i // 7, 3)
    assert abs(uniform.mean() - 0.5) < 4 / np.sqrt(12 * 20_000)
    assert abs(uniform.std() - 12**-0.5) < 0.005


def test_surfaces_have_texture_and_stay_in_range():
    rng = np.random.default_rng(0)
    u, z = rng.uniform(0, 9, 4000), rng.uniform(0, 3, 4000)
    for colour in (
        texture.floor_colour(u, z, 1.0),
        texture.wall_colour(u, z, 1, 3.0, 1.0),
        texture.pillar_colour(u, z, 2, 1.0),
        texture.ceiling_colour(u, z, 1.0),
    ):
        assert colour.shape == (4000, 3)
        assert colour.min() >= 0
        assert colour.max() < 300
        assert colour.std(axis=0).min() > 3


def test_lamps_hang_in_the_room_apart_and_light_falls_with_distance():
    bent = np.array([[0.0, 0.0], [16.0, 0.0], [16.0, 5.0], [5.0, 5.0], [5.0, 16.0], [0.0, 16.0]])
    lights = lamps(bent, 3.0)
    assert np.hypot(*(lights[0, :2] - lights[1, :2])) > 3
    assert all((x < 5 or y < 5) and 0 < x < 16 and 0 < y < 16 for x, y in lights[:, :2])
    one = lights[:1]
    below = light_at(one[0, 0], one[0, 1], 0.0, 0.0, 0.0, 1.0, one, 0.5)
    aside = light_at(one[0, 0] + 3.0, one[0, 1], 0.0, 0.0, 0.0, 1.0, one, 0.5)
    away = light_at(one[0, 0], one[0, 1], 0.0, 0.0, 0.0, -1.0, one, 0.5)
    assert below > aside > away == 0.5


def test_a_prism_throws_a_shadow_up_to_its_height():
    wall = np.array([[1.0, -1.0], [1.2, -1.0], [1.2, 1.0], [1.0, 1.0]])
    starts = np.array([0, 4])
    lamp = (0.0, 0.0, 3.0)
    low, high = np.array([1.0]), np.array([3.0])
    assert in_shadow(1.5, 0.0, 0.0, *lamp, wall, starts, low)
    assert not in_shadow(3.0, 0.0, 0.0, *lamp, wall, starts, low)  # the way passes over the wall
    assert in_shadow(3.0, 0.0, 0.0, *lamp, wall, starts, high)
    assert not in_shadow(0.5, 0.0, 0.0, *lamp, wall, starts, high)


def test_two_sided_shirts_are_the_next_target_s_behind():
    """Four hues in a ring; all else is as without, and the cloth changes where the front meets the back."""
    outfits = [dress(k, True, np.random.default_rng(5), two_sided=True) for k in range(4)]
    plain = [dress(k, True, np.random.default_rng(5)) for k in range(4)]
    for k in range(4):
        assert outfits[k].second[SHIRT] == pytest.approx(outfits[(k + 1) % 4].first[SHIRT])
        assert (outfits[k].first == plain[k].first).all()
        assert outfits[k].pattern.tolist() == [0, 0, SIDES, 0, 0]
    assert [cloth(qx, 0.3, 0.2, 0.3, SIDES, 1.0) for qx in (-0.1, 0.0, 0.1)] == [0.0, 1.0, 1.0]
