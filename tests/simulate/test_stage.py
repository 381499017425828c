import itertools
import tracemalloc

import numpy as np
import pytest
from scipy.spatial.distance import pdist

from occlog.errors import InputError
from occlog.records.scene import Occluder, Scene
from occlog.records.tables import Truth
from occlog.simulate.config import START_NS, WorldConfig
from occlog.simulate.stage import motion_in_a_step, simulate_truth

ROOM = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 100.0], [0.0, 100.0]])
SCENE = Scene(
    room=ROOM,
    occluders=(Occluder("pillar", np.array([[40.0, 40.0], [60.0, 40.0], [60.0, 60.0], [40.0, 60.0]])),),
    length_unit="unit",
)


def truth(config, seed=1, scene=SCENE):
    return Truth.concat(simulate_truth(scene, config, seed))


@pytest.mark.jit
def test_rows_are_complete_and_targets_come_first():
    table = truth(WorldConfig(steps=300, targets=2, occluders=3, object_height=1.5))
    assert len(table) == 300 * 5
    assert table.t_ns[::5].tolist() == [START_NS + k * 10**9 for k in range(300)]
    assert table.target_id[:5].tolist() == [0, 1, 2, 3, 4]
    assert table.role[:5].tolist() == ["target"] * 2 + ["occluder"] * 3
    assert (table.z == 1.5).all()
    xy = np.column_stack([table.x, table.y]).reshape(300, 5, 2)
    assert min(pdist(places).min() for places in xy) >= 3.33 * (1 - 1e-12)
    steps = np.linalg.norm(np.diff(xy, axis=0), axis=2)
    assert 0.9 < steps.mean() < 1.1
    assert steps.max() < 1 + 6 * 0.33  # no jump between chunks


@pytest.mark.jit
def test_the_same_seed_gives_the_same_and_another_another():
    config = WorldConfig(steps=40, occluders=4)
    assert (truth(config, 5).x == truth(config, 5).x).all()
    assert (truth(config, 5).x != truth(config, 6).x).any()


@pytest.mark.jit
def test_a_longer_run_begins_like_a_shorter_one():
    short, long = truth(WorldConfig(steps=10, occluders=4)), truth(WorldConfig(steps=600, occluders=4))
    assert (long.x[: len(short)] == short.x).all()


@pytest.mark.jit
def test_speed_and_noise_keep_their_meaning_when_the_step_changes():
    """Four seconds of a walk in the open: mean length 4, noise 0.33 sqrt(4) per axis, at 1, 5 and 10 Hz."""
    wide = Scene(room=1e5 * ROOM, length_unit="unit")
    for step_s in (1.0, 0.2, 0.1):
        per = round(4 / step_s)
        config = WorldConfig(steps=20 * per + 1, step_s=step_s, targets=40, redirect_probability=0.0, diameter=1e-6)
        table = truth(config, 3, wide)
        xy = np.column_stack([table.x, table.y]).reshape(-1, 40, 2)[::per]
        ways = np.diff(xy, axis=0)
        heading = (xy[-1] - xy[0]) / np.linalg.norm(xy[-1] - xy[0], axis=1)[:, None]
        along = np.sum(ways * heading, axis=2)
        across = ways[..., 0] * heading[:, 1] - ways[..., 1] * heading[:, 0]
        n = along.size
        assert abs(along.mean() - 4.0) < 4 * 0.66 / np.sqrt(n)
        assert abs(across.std() - 0.66) < 4 * 0.66 / np.sqrt(2 * n) + 0.66 / 20  # the heading itself is estimated
        chance = motion_in_a_step(config).redirect
        assert chance == 0.0


def test_redirect_is_per_second():
    assert motion_in_a_step(WorldConfig(step_s=1.0)).redirect == pytest.approx(0.095)
    assert (1 - motion_in_a_step(WorldConfig(step_s=0.1)).redirect) ** 10 == pytest.approx(1 - 0.095)
    assert motion_in_a_step(WorldConfig(redirect_probability=1.0)).redirect == 1.0


def test_people_have_the_same_size_in_metres_and_feet():
    metres, feet = WorldConfig.in_unit("m"), WorldConfig.in_unit("ft")
    assert feet.diameter * 0.3048 == pytest.approx(metres.diameter)
    assert feet.speed * 0.3048 == pytest.approx(metres.speed)
    assert feet.step_s == metres.step_s
    assert WorldConfig.in_unit("unit") == WorldConfig()


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"steps": 0}, "steps is 0, must be at least 1"),
        ({"speed": 0.0}, "speed is 0.0, must be above 0"),
        ({"redirect_probability": 1.5}, "redirect_probability is 1.5, must be at least 0 and at most 1"),
        ({"process_noise_position": float("nan")}, "process_noise_position is nan, must be finite and at least 0"),
        ({"targets": -1}, "targets is -1, must be at least 0"),
    ],
)
def test_impossible_values_are_reported(values, says):
    with pytest.raises(InputError, match=says):
        WorldConfig(**values)


def test_a_world_without_objects_is_reported():
    with pytest.raises(InputError, match="targets and occluders are both 0; give at least one object"):
        truth(WorldConfig(targets=0))


@pytest.mark.jit
def test_a_room_that_is_too_small_is_reported():
    with pytest.raises(InputError, match="use fewer or smaller objects, or a larger room"):
        truth(WorldConfig(steps=2, occluders=100, diameter=30.0))


def test_occluders_alone_can_be_simulated():
    table = truth(WorldConfig(steps=5, targets=0, occluders=2))
    assert set(table.role) == {"occluder"}
    assert table.target_id.tolist() == [0, 1] * 5


@pytest.mark.jit
def test_memory_does_not_grow_with_the_number_of_steps():
    def peak(steps):
        tracemalloc.start()
        for _ in itertools.islice(simulate_truth(SCENE, WorldConfig(steps=steps), 1), 10**9):
            pass
        top = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return top

    peak(256)
    # Ten times as many steps; what they hold in all would be ten times as much
    assert peak(256 * 40) < 1.5 * peak(256 * 4)
