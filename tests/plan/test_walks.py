"""Who walks where: people who keep apart, ways that end in their cells, sight and motion as in `occlog simulate`."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from occlog.array_types import Bools, Floats
from occlog.core.geometry.camera import rotation_from_angles
from occlog.core.geometry.visibility import behind_objects
from occlog.errors import InputError
from occlog.plan.config import PlanConfig
from occlog.plan.filtering import FilterNoise, Motion, Reports, errors_along
from occlog.plan.sensing import hide_behind_crowd
from occlog.plan.stage import prepare
from occlog.plan.walks import cell_visits, cells_of, moments_of, nearest_cell, paths_through_cells, simulate_crowd
from occlog.records.scene import Camera, Occluder, Scene
from occlog.records.tables import Truth
from occlog.simulate.config import WorldConfig
from occlog.simulate.sensors.cameras import visible
from occlog.simulate.stage import simulate_truth

ROOM = np.array([[0.0, 0.0], [6.0, 0.0], [6.0, 6.0], [0.0, 6.0]])
CROWD = replace(PlanConfig.in_unit("m"), people=11, cells=36, samples_per_cell=64, settling_s=0.4)


def corner(name: str, x: float, y: float, yaw_deg: float) -> Camera:
    return Camera(
        name=name,
        position=np.array([x, y, 0.0]),
        rotation=rotation_from_angles(math.radians(yaw_deg), 0.0, 0.0),
        focal_px=np.full(2, 160.0),
        principal_px=np.array([159.5, 119.5]),
        image_size=(320, 240),
        fov=math.radians(90.0),
    )


CORNERS = (corner("sw", 0.0, 0.0, 45.0), corner("se", 6.0, 0.0, 135.0), corner("ne", 6.0, 6.0, 225.0))
SCENE = Scene(cameras=CORNERS, room=ROOM)


def test_a_target_is_hidden_by_all_but_itself_as_the_simulator_says():
    rng = np.random.default_rng(5)
    people, origin = rng.uniform(0.0, 6.0, (50, 5, 2)), np.array([0.5, -0.2])
    first, own = rng.integers(0, 41, 200), rng.integers(0, 5, 200)
    step = first[:, None] + np.arange(10)
    ways = np.ascontiguousarray(people[step, own[:, None]])
    seen = np.ones((200, 10), dtype=np.bool_)
    hide_behind_crowd(seen, ways, origin, people, first, own, 0.5, 0.0)
    for i in range(200):
        others = np.delete(people[step[i]], own[i], axis=1)
        np.testing.assert_array_equal(seen[i], ~behind_objects(origin, ways[i], others, 0.5))
    assert 0.1 < np.mean(~seen) < 0.5


def test_ways_are_stretches_of_the_walk_that_end_in_their_cells_and_people_keep_apart():
    pillar = Occluder("pillar", np.array([[2.5, 2.5], [3.5, 2.5], [3.5, 3.5], [2.5, 3.5]]))
    scene = replace(SCENE, occluders=(pillar,))
    cells, steps = cells_of(scene, 49), 30
    people = simulate_crowd(scene, CROWD, 0.1, steps, seed=2)
    visits = cell_visits(cells, people, steps)
    walked = paths_through_cells(visits, people, 20, steps, 0.1)
    assert walked.ways.shape == (20 * len(cells.xy), steps, 2)
    np.testing.assert_array_equal(nearest_cell(cells, walked.ways[:, -1]), np.repeat(np.arange(len(cells.xy)), 20))
    for i in range(0, len(walked.ways), 97):
        segment = people[walked.first[i] : walked.first[i] + steps, walked.own[i]]
        np.testing.assert_array_equal(walked.ways[i], segment)
    assert len(set(walked.own.tolist())) == people.shape[1] == 12
    some = people[::500]
    apart = np.hypot(*(some[:, :, None] - some[:, None]).transpose(3, 0, 1, 2))
    assert apart[:, ~np.eye(12, dtype=bool)].min() >= CROWD.person_diameter


def test_a_cell_that_no_one_came_to_has_the_ways_of_its_neighbour():
    cells = cells_of(SCENE, 36)
    people = np.tile([1.5, 1.5], (10, 1, 1)) + 0.01 * np.arange(10)[:, None, None]
    walked = paths_through_cells(cell_visits(cells, people, 3), people, 4, 3, 0.1)
    assert walked.ways.shape == (144, 3, 2)
    assert np.abs(walked.ways - 1.5).max() < 0.1


def simulated_sight(seed: int) -> Bools:
    """(T,) by how few of the corner cameras a simulated target is seen, after 10 s."""
    world = replace(WorldConfig.in_unit("m"), steps=600, targets=1, occluders=11, wall_clearance=0.0)
    truth = Truth.concat(simulate_truth(SCENE, world, seed))
    positions = np.stack([truth.x, truth.y, np.zeros(len(truth))], axis=-1).reshape(600, 12, 3)[100:]
    return sum(visible(c, SCENE.blockers(c.ground), positions, 0, 0.5).astype(np.int64) for c in CORNERS)


def test_people_hide_the_target_as_often_and_as_long_as_in_the_simulator():
    """Fewer than two of three cameras see it in a third of the time; the error bar over 60 runs is 3 % of that.

    A crowd that walks without heeding the target hides it in a sixth less of the time.
    """
    runs = np.array([simulated_sight(seed) < 2 for seed in range(60)])
    whole = runs.mean(axis=1)
    lasting = (runs[:, 5:] & runs[:, :-5]).mean(axis=1)
    # Places of all simulated targets weigh the floor
    world = replace(WorldConfig.in_unit("m"), steps=600, targets=12, occluders=0, wall_clearance=0.0)
    truths = [Truth.concat(simulate_truth(SCENE, world, seed)) for seed in range(100, 140)]
    paths = np.concatenate([np.column_stack([t.x, t.y])[100 * 12 :] for t in truths])
    plan = prepare(SCENE, replace(CROWD, settling_s=0.6, cells=144), seed=0, paths=paths)
    seen = sum(reported.seen.astype(np.int64) for reported in plan.information.values()) < 2
    now = plan.weight @ seen[:, -1].reshape(len(plan.weight), -1).mean(axis=1)
    both = plan.weight @ (seen[:, -1] & seen[:, -6]).reshape(len(plan.weight), -1).mean(axis=1)
    for found, expected in ((whole, now), (lasting, both)):
        error = found.std(ddof=1) / math.sqrt(len(found))
        assert error < 0.04 * found.mean()
        assert expected == pytest.approx(found.mean(), abs=3.5 * error)


def turning(motion: Motion, dt: float, steps: int, many: int) -> Floats:
    """(steps, many, 2) places of walkers who turn at random."""
    rng = np.random.default_rng(11)
    v = motion.speed * math.sqrt(0.5) * rng.standard_normal((many, 2))
    x, path = np.zeros((many, 2)), np.empty((steps, many, 2))
    for t in range(steps):
        turns = rng.random(many) < -math.expm1(-motion.turns * dt)
        v[turns] = motion.speed * math.sqrt(0.5) * rng.standard_normal((int(turns.sum()), 2))
        x = x + dt * v + motion.sigma * math.sqrt(dt) * rng.standard_normal((many, 2))
        path[t] = x
    return path


@pytest.mark.parametrize("motion", [Motion(1.2, 0.4, 0.05), Motion(0.8, 2.0, 0.2), Motion(1.0, 0.05, 0.0)])
def test_the_moments_of_walkers_who_turn_at_random_are_found(motion: Motion):
    """400 walkers for 100 s: speed to 1 %, turns to 4 %, noise to 2 %, each three error bars or more."""
    found = moments_of(turning(motion, 0.1, 1000, 400), 0.1)
    assert found.speed == pytest.approx(motion.speed, rel=0.03)
    assert found.turns == pytest.approx(motion.turns, rel=0.12)
    assert found.sigma == pytest.approx(motion.sigma, rel=0.06, abs=0.02)


def test_steps_that_say_nothing_of_the_next_are_noise_alone():
    steps = np.array([[0.1, 0.0], [0.0, 0.1], [-0.1, 0.0], [0.0, -0.1]] * 50)
    found = moments_of(np.cumsum(steps, axis=0)[:, None], 0.5)
    assert found.speed == 0.0
    assert found.sigma == pytest.approx(math.sqrt(0.01 / (2.0 * 0.5)))


def test_walkers_who_never_turn_keep_their_velocity():
    straight = np.arange(200.0)[:, None, None] * np.array([[[0.3, 0.4], [0.5, 0.0]]])
    found = moments_of(straight, 1.0)
    assert found.speed == pytest.approx(0.5, rel=1e-2)
    assert found.turns < 1e-3
    assert found.sigma < 0.05


def test_a_filter_of_these_moments_is_as_far_off_in_a_crowd_as_it_says():
    """In gaps of 1 and 2 s of a crowded walk; the error bar of the ratio is 4 %."""
    dt, steps, variance = 0.1, 120, 0.01
    people = simulate_crowd(SCENE, CROWD, dt, steps, seed=4)
    motion = moments_of(people, dt)
    rng = np.random.default_rng(8)
    starts = np.arange(0, len(people) - steps, steps)
    truth = np.concatenate([people[s : s + steps].transpose(1, 0, 2) for s in starts])
    t = np.arange(steps)
    seen = ~((t % 40 >= 20) & (t % 40 < 30)) & ~(t >= 100)
    information = np.zeros((3, *truth.shape[:2]))
    information[0] = information[2] = seen / variance
    noise = np.sqrt(information[0]) * rng.standard_normal((2, *truth.shape[:2]))
    start = ROOM.mean(axis=0), 3.0 * np.eye(2)
    found = errors_along(truth, Reports(information, noise), start, motion, FilterNoise(0.0, 0.0), dt, keep=100)
    square = np.sum((found.position - truth[:, 20:]) ** 2, axis=-1).mean(axis=0)
    reported = np.trace(found.covariance, axis1=-2, axis2=-1).mean(axis=0)
    for part in (slice(40, 50), slice(80, 100), slice(100)):
        assert math.sqrt(square[part].mean()) == pytest.approx(math.sqrt(reported[part].mean()), rel=0.12)


def test_people_who_would_walk_for_ever_are_refused() -> None:
    with pytest.raises(InputError, match=r"at a speed of 1e-15 crossing the room takes .* state a higher speed"):
        simulate_crowd(SCENE, replace(CROWD, speed=1e-15), 0.1, 10, seed=4)
