"""Scripted targets against closed forms, the motion of particles, and themselves in other steps."""

import math

import numpy as np
import pytest

from occlog.core.numerics.interpolate import TimeGrid
from occlog.errors import InputError
from occlog.filtering.motion.coordinated_turn import acceleration_root, move
from occlog.records.scene import MotionScript, Occluder, Scene, ScriptedTarget, Segment
from occlog.simulate.config import ObserveConfig, SoundConfig
from occlog.simulate.sensors.arrays import observe_arrays
from occlog.simulate.world.scripted_paths import check_inside, grid_truth, moved, silences, simulate_paths

NAN = math.nan
START = 10**18


def places(
    *targets: ScriptedTarget, steps: int = 201, step_s: float = 0.1, z: float = NAN, seed: int = 0
) -> np.ndarray:
    grids = list(simulate_paths(MotionScript(targets), steps, step_s, z, START, seed))
    assert [len(g.t_ns) for g in grids[:-1]] == [256] * (len(grids) - 1)
    assert np.array_equal(np.concatenate([g.t_ns for g in grids]), START + np.rint(np.arange(steps) * step_s * 1e9))
    return np.concatenate([g.xyz for g in grids])


def test_constant_velocity_acceleration_and_a_new_velocity() -> None:
    segments = (
        Segment(2.0, 5.05, acceleration=(0.1, -0.2, 0.5)),
        Segment(8.0, velocity=(0.0, 3.0, -1.0)),
    )
    got = places(ScriptedTarget(4, (1.0, 2.0, 3.0), (0.5, 0.0, -0.1), segments=segments))[:, 0]
    t = np.arange(201) * 0.1
    a, v = np.array([0.1, -0.2, 0.5]), np.array([0.5, 0.0, -0.1])
    pushed, after = np.clip(t - 2.0, 0, 3.05)[:, None], np.clip(t - 5.05, 0, 2.95)[:, None]
    until8 = np.minimum(t, 8.0)[:, None]
    want = [1.0, 2.0, 3.0] + v * until8 + 0.5 * a * pushed**2 + 3.05 * a * after
    want += np.array([0.0, 3.0, -1.0]) * np.clip(t - 8.0, 0, None)[:, None]
    assert np.allclose(got, want, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("plane", "i", "j"), [("xy", 0, 1), ("yz", 1, 2), ("zx", 2, 0)])
def test_turn_is_a_circle_from_the_first_axis_to_the_second(plane: str, i: int, j: int) -> None:
    lateral, velocity = 0.3, [0.0, 0.0, 0.0]
    k = 3 - i - j
    velocity[i], velocity[k] = 2.0, 0.7
    got = places(ScriptedTarget(0, (0.0, 0.0, 5.0), tuple(velocity), segments=(Segment(0, math.inf, lateral, plane),)))
    t, rate = np.arange(201) * 0.1, lateral / 2.0
    radius = 2.0 / rate
    want = np.tile([0.0, 0.0, 5.0], (201, 1))
    want[:, i] += radius * np.sin(rate * t)
    want[:, j] += radius * (1 - np.cos(rate * t))
    want[:, k] += 0.7 * t
    assert np.allclose(got[:, 0], want, rtol=0, atol=1e-11)


def test_a_step_is_that_of_the_particles() -> None:
    rng = np.random.default_rng(5)
    for lateral, a in ((0.2, (0.0, 0.0)), (-0.4, (0.0, 0.0)), (0.0, (0.3, -0.1))):
        x, vx, y, vy = rng.normal(size=4)
        want = move(np.array([[x, vx, y, vy]]), np.array([lateral, *a]), 0.7, np.zeros((2, 2)), np.zeros((1, 4)))[0]
        got = moved(np.array([x, y, NAN, vx, vy, 0.0]), Segment(0, 9, lateral, "xy", (*a, 0.0)), 0.7)
        assert np.allclose(got[[0, 3, 1, 4]], want, rtol=1e-13, atol=1e-13)
    rest = np.array([1.0, 2.0, 3.0, 0.0, 0.0, 0.0])
    assert (moved(rest, Segment(0, 9, 1.0), 2.0) == rest).all()


def test_steps_do_not_change_the_path_and_more_steps_only_add() -> None:
    turns = (Segment(1.23, 4.56, 0.2), Segment(4.56, 7.0, -0.5), Segment(9.0, 11.1, acceleration=(0.0, 0.1, 0.0)))
    path = ScriptedTarget(1, (0.0, 0.0, NAN), (1.0, 0.3, 0.0), segments=turns)
    coarse, fine = places(path, steps=21, step_s=1.0), places(path, steps=2001, step_s=0.01)
    assert np.allclose(coarse[..., :2], fine[::100, :, :2], rtol=0, atol=1e-10)
    noisy = ScriptedTarget(1, (0.0, 0.0, 1.0), (1.0, 0.3, 0.0), noise_density=0.1, segments=turns)
    other = ScriptedTarget(0, (5.0, 5.0, 1.0), noise_density=1.0)
    long = places(noisy, steps=600)
    assert np.array_equal(long[:300], places(noisy, steps=300))
    assert np.array_equal(long, places(other, noisy, steps=600)[:, 1:])  # whoever else is there
    assert not np.allclose(long[1:], places(noisy, steps=600, seed=1)[1:])


def test_coming_going_and_heights() -> None:
    here = ScriptedTarget(3, (1.0, 1.0, NAN), (1.0, 0.0, 0.0), from_s=0.25, until_s=0.6)
    got = places(here, steps=10, z=1.7)[:, 0]
    assert np.isfinite(got[:, 0]).tolist() == [False] * 3 + [True] * 4 + [False] * 3
    assert np.allclose(got[3:7, 0], 1.0 + np.arange(0.05, 0.36, 0.1))
    assert (got[3:7, 2] == 1.7).all()
    assert np.isnan(places(here)[..., 2]).all()
    grid = next(
        simulate_paths(MotionScript((here, ScriptedTarget(5, (0.0, 0.0, 2.0), role="occluder"))), 9, 0.1, NAN, 0, 0)
    )
    truth = grid_truth(grid)
    assert truth.target_id.tolist() == [5, 5, 5, 3, 5, 3, 5, 3, 5, 3, 5, 5, 5]
    assert set(zip(truth.target_id.tolist(), truth.role.tolist(), strict=True)) == {(3, "target"), (5, "occluder")}


def test_noise_has_the_variance_of_white_acceleration() -> None:
    density, dt, n = 0.3, 0.5, 1000
    crowd = [ScriptedTarget(k, (0.0, 0.0, 0.0), noise_density=density) for k in range(n)]
    end = places(*crowd, steps=2, step_s=dt)[1]
    root = acceleration_root(density, dt)
    variance = float((root @ root.T)[0, 0])
    assert math.isclose(variance, density * dt**3 / 3)
    # 3000 independent draws: relative error of the variance sqrt(2 / 3000) = 2.6 %; four of these
    assert abs(end.var() / variance - 1) < 4 * math.sqrt(2 / 3000)
    late = places(*crowd[:200], steps=9, step_s=dt)[8]  # 4 s: density t^3 / 3 however it was cut
    assert abs(late.var() / (density * 4.0**3 / 3) - 1) < 4 * math.sqrt(2 / 600)


def test_silence_is_counted_from_the_first_step() -> None:
    script = MotionScript((ScriptedTarget(2, (0, 0, 0), silent=((1.5, 2.0), (3.0, 4.0))), ScriptedTarget(7, (0, 0, 0))))
    got = silences(script, 100)
    assert list(got) == [2]
    assert got[2].tolist() == [[1_500_000_100, 2_000_000_100], [3_000_000_100, 4_000_000_100]]


def test_people_are_drawn_on_the_free_floor_only() -> None:
    room = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])
    scene = Scene(room=room, occluders=(Occluder("pillar", 1.0 + room / 4),))
    for x, y, message in (
        (3.0, 3.0, "target 6 is outside the room at 2 s"),
        (0.5, 1.5, "target 6 is inside pillar at 1 s"),
    ):
        path = MotionScript((ScriptedTarget(6, (x, y, NAN), (0.6, 0.0, 0.0)),))
        with pytest.raises(InputError, match=message):
            check_inside(scene, next(simulate_paths(path, 4, 1.0, NAN, START, 0)), START)
    check_inside(scene, next(simulate_paths(MotionScript((ScriptedTarget(6, (3.0, 3.0, NAN)),)), 4, 1.0, NAN, 0, 0)), 0)


def test_no_one_for_a_whole_chunk_is_no_gap() -> None:
    from occlog.records.scene import MicrophoneArray

    path = MotionScript((ScriptedTarget(0, (1.0, 0.0, NAN), from_s=300.0),))
    grids: list[TimeGrid] = list(simulate_paths(path, 400, 1.0, NAN, START, 0))
    scene = Scene(arrays=(MicrophoneArray("m", np.zeros(3), planar=True),))
    rows = list(observe_arrays(scene, grids, ObserveConfig(), 0, SoundConfig(label_doa=True)))
    assert [len(r) for r in rows] == [0, 100]
    assert rows[1].t_ns[0] == START + 300 * 10**9
    assert (rows[1].source_id == 0).all()
