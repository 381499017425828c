import numpy as np
import pytest
from scipy.spatial.distance import pdist
from scipy.special import ive

from occlog.core.plane import distance_to_boundary, inside_polygon, line_of_sight_blocked, pack_polygons, pockets
from occlog.simulate.world.waypoints import CANDIDATES, Ground, WaypointMotion, WaypointNoise, populate, walk

SQUARE = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 100.0], [0.0, 100.0]])
PILLAR = np.array([[40.0, 40.0], [60.0, 40.0], [60.0, 60.0], [40.0, 60.0]])
L_ROOM = np.array([[0.0, 0.0], [80.0, 0.0], [80.0, 26.0], [26.0, 26.0], [26.0, 80.0], [0.0, 80.0]])
REFERENCE = WaypointMotion(step=1.0, sigma=0.33, redirect=0.095, diameter=3.33)


def ground(room, pillars=(), clearance=0.0):
    return Ground(room, *pack_polygons([*pillars, *pockets(room)]), clearance)


def draws(rng, steps, n):
    return WaypointNoise(
        rng.standard_normal((steps, n, 2)), rng.random((steps, n)), rng.random((steps, n, CANDIDATES, 2))
    )


def run(floor, motion, n, steps, seed):
    rng = np.random.default_rng(seed)
    world = populate(n, floor, motion.diameter, rng)
    start = world.xy
    _, path, changed = walk(world, floor, motion, draws(rng, steps, n))
    return np.concatenate([start[None], path]), changed


@pytest.mark.jit
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    ("room", "pillars", "clearance", "n"),
    [(SQUARE, [PILLAR], 0.0, 41), (SQUARE, [PILLAR], 1.665, 20), (L_ROOM, [], 0.0, 30), (L_ROOM, [], 1.0, 12)],
)
def test_objects_stay_in_the_room_out_of_pillars_and_apart(seed, room, pillars, clearance, n):
    path, _ = run(ground(room, pillars, clearance), REFERENCE, n, 400, seed)
    flat = path.reshape(-1, 2)
    assert inside_polygon(flat, room).all()
    for polygon in pillars:
        assert not inside_polygon(flat, polygon).any()
        assert not any(
            line_of_sight_blocked(a, b[None], polygon)[0] for a, b in zip(path[:-1, 0], path[1:, 0], strict=True)
        )
    if clearance:
        for polygon in [room, *pillars]:
            assert min(distance_to_boundary(x, y, polygon) for x, y in flat) >= clearance
    assert min(pdist(places).min() for places in path) >= 3.33 * (1 - 1e-12)


@pytest.mark.jit
def test_steps_have_the_stated_speed_and_noise():
    """Without obstacles a step is the unit step towards the destination plus N(0, 0.33^2 I)."""
    huge = 1e6 * SQUARE
    path, _ = run(ground(huge), WaypointMotion(1.0, 0.33, 0.0, 1e-9), 50, 1000, 3)
    steps = np.diff(path, axis=0)
    heading = path[-1] - path[0]
    heading /= np.linalg.norm(heading, axis=1)[:, None]
    along = np.sum(steps * heading, axis=2)
    across = steps[..., 0] * heading[:, 1] - steps[..., 1] * heading[:, 0]
    n = along.size
    assert abs(along.mean() - 1.0) < 4 * 0.33 / np.sqrt(n)
    for part in (along, across):
        assert abs(part.std() - 0.33) < 4 * 0.33 / np.sqrt(2 * n)
    # The length of a step is Rice distributed: mean sigma sqrt(pi/2) L_1/2(-1 / (2 sigma^2)).
    a = 1.0 / (4 * 0.33**2)
    rice = 0.33 * np.sqrt(np.pi / 2) * ((1 + 2 * a) * ive(0, a) + 2 * a * ive(1, a))
    length = np.linalg.norm(steps, axis=2)
    assert abs(length.mean() - rice) < 4 * length.std() / np.sqrt(n)


@pytest.mark.jit
def test_destinations_change_with_the_stated_probability():
    """With destinations out of reach the time between changes is geometric with mean 1 / 0.095."""
    _, changed = run(ground(1e6 * SQUARE), WaypointMotion(1.0, 0.33, 0.095, 1e-9), 20, 2000, 4)
    n = changed.size
    assert abs(changed.mean() - 0.095) < 4 * np.sqrt(0.095 * 0.905 / n)
    gaps = np.concatenate([np.diff(np.flatnonzero(c)) for c in changed.T])
    assert abs(gaps.mean() - 1 / 0.095) < 4 * np.sqrt(1 - 0.095) / 0.095 / np.sqrt(len(gaps))


@pytest.mark.jit
def test_plain_waypoints_take_the_mean_distance_between_two_random_points():
    """Without noise a leg of length d takes floor(d / s) steps; E d = 0.5214 L between uniform points of a square."""
    mean = 100 * (2 + np.sqrt(2) + 5 * np.log(1 + np.sqrt(2))) / 15
    _, changed = run(ground(SQUARE), WaypointMotion(1.0, 0.0, 0.0, 1e-9), 40, 4000, 5)
    legs = np.concatenate([np.diff(np.flatnonzero(c)) for c in changed.T])
    spread = legs.std() / np.sqrt(len(legs))
    assert abs(legs.mean() - (mean - 0.5)) < 4 * spread + 0.5  # a leg starts up to a step off the old destination


@pytest.mark.jit
def test_waypoints_plus_gives_the_rmse_about_the_centre_that_the_paper_states():
    """[Ercan] Sec. 6.1: 24.4 units without any measurement; waypoints that only change on arrival stay below."""
    path, _ = run(ground(SQUARE, [PILLAR]), REFERENCE, 41, 3000, 6)
    rmse = np.sqrt(np.mean(np.sum((path - 50.0) ** 2, axis=2), axis=0))
    assert abs(rmse.mean() - 24.4) < 4 * rmse.std() / np.sqrt(41) + 0.4


def test_two_objects_that_meet_go_around_each_other():
    floor = ground(np.array([[0.0, 0.0], [40.0, 0.0], [40.0, 20.0], [0.0, 20.0]]))
    world = populate(2, floor, 3.0, np.random.default_rng(0))._replace(
        xy=np.array([[5.0, 10.0], [35.0, 10.0]]), destination=np.array([[35.0, 10.0], [5.0, 10.0]])
    )
    motion = WaypointMotion(1.0, 0.0, 0.0, 3.0)
    _, path, _ = walk(world, floor, motion, draws(np.random.default_rng(1), 32, 2))
    assert path[:, 0, 0].max() > 32
    assert path[:, 1, 0].min() < 8
    assert np.linalg.norm(path[:, 0] - path[:, 1], axis=1).min() >= 3.0
    assert path[:, 0, 1].min() < 9.0
    assert path[:, 1, 1].max() > 11.0


@pytest.mark.jit
def test_a_crowd_keeps_moving():
    path, _ = run(ground(SQUARE, [PILLAR]), REFERENCE, 41, 1000, 7)
    length = np.linalg.norm(np.diff(path, axis=0), axis=2)
    assert length.mean() > 0.9
    assert np.mean(length == 0) < 0.02


def test_walking_on_equals_walking_at_once():
    floor, rng = ground(SQUARE, [PILLAR]), np.random.default_rng(8)
    world, d = populate(10, floor, 3.33, rng), draws(rng, 60, 10)
    whole, path, _ = walk(world, floor, REFERENCE, d)
    half, first, _ = walk(world, floor, REFERENCE, WaypointNoise(*(a[:25] for a in d)))
    end, second, _ = walk(half, floor, REFERENCE, WaypointNoise(*(a[25:] for a in d)))
    assert (np.concatenate([first, second]) == path).all()
    assert (end.xy == whole.xy).all()
    assert end.step == whole.step == 60


@pytest.mark.jit
def test_a_full_room_is_reported():
    with pytest.raises(ValueError, match=r"after \d+ objects of diameter 50"):
        populate(10, ground(SQUARE), 50.0, np.random.default_rng(0))
