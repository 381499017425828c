"""What microphone arrays cannot tell apart, silence, false directions, and noise about tilted axes."""

import math

import numpy as np
import pytest

from occlog.core.geometry.camera import array_rotation, wrap_angle
from occlog.core.numerics.interpolate import TimeGrid
from occlog.errors import InputError
from occlog.records.scene import MicrophoneArray, Scene
from occlog.records.tables import Doa
from occlog.simulate.config import ObserveConfig, SoundConfig
from occlog.simulate.sensors.arrays import observe_arrays

QUIET = 1e-9  # noise so small that directions are true ones


def grid_of(places, start=0, step_ns=10**9):
    t, n = places.shape[:2]
    return TimeGrid(
        start + np.arange(t) * step_ns, np.arange(n), np.ones(n, dtype=bool), np.asarray(places, dtype=float)
    )


def heard(places, array, sound=SoundConfig(), seed=3, silent=None, miss=0.0):  # noqa: B008 - frozen
    chunks = [places] if isinstance(places, TimeGrid) else [grid_of(places)]
    return Doa.concat(
        observe_arrays(Scene(arrays=(array,)), chunks, ObserveConfig(miss_probability=miss), seed, sound, silent)
    )


def on_circle(*degrees, z=0.0, radius=5.0):
    angles = np.radians(degrees)
    return np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.full(len(angles), z)])[None]


def array(**values):
    return MicrophoneArray("mic", np.zeros(3), **{"sigma": QUIET, **values})


@pytest.mark.parametrize(
    ("degrees", "want"),
    [
        ((10, 20), [10, 20]),
        ((10, 12), [11]),
        ((10, 12.99), [11.495]),
        ((10, 13.01), [10, 13.01]),
        ((10, 12, 14), [12]),  # the ends hang together by the middle
        ((10, 14, 12), [12]),
        ((179, -179), [-180]),
        ((40, 10, 42, 11.5, 100), [10.75, 41, 100]),
        ((0, 2.5, 5, 7.5, 10), [5]),
    ],
)
@pytest.mark.parametrize("z", [math.nan, 0.0])
def test_sources_nearer_than_the_resolution_are_one(degrees, want, z):
    got = heard(on_circle(*degrees, z=z), array(resolution=math.radians(3)))
    assert np.allclose(np.sort(wrap_angle(got.azimuth - np.radians(want))), 0, atol=1e-6)
    assert len(got) == len(want)


def test_mean_is_by_direction_not_by_place_and_the_silent_and_far_do_not_count():
    near_far = np.array([[[1.0, 0.0, 0.0], [100 * math.cos(0.04), 100 * math.sin(0.04), 0.0]]])
    ear = array(resolution=0.05, range=200.0)
    assert np.allclose(heard(near_far, ear).azimuth, [0.02], atol=1e-8)
    assert np.allclose(heard(near_far, array(resolution=0.05, range=50.0)).azimuth, [0.0], atol=1e-8)
    silent = {0: np.array([[0, 5]])}
    assert np.allclose(heard(near_far, ear, silent=silent).azimuth, [0.04], atol=1e-8)
    labelled = heard(near_far, ear, SoundConfig(label_doa=True))
    assert labelled.source_id.tolist() == [0]


def test_arc_and_azimuth_differ_where_heights_do():
    positions = np.array([[[5.0, 0.0, 0.0], [5.0, 0.0, 5.0]]])  # one azimuth, 45 degrees apart
    assert len(heard(positions, array(resolution=0.5))) == 2
    flat = heard(positions, array(resolution=0.5, planar=True))
    assert len(flat) == 1
    assert np.isnan(flat.elevation).all()
    wide = heard(positions, array(resolution=0.8))
    assert np.allclose([wide.azimuth[0], wide.elevation[0]], [0.0, np.pi / 8], atol=1e-6)
    high = on_circle(0, 90, z=100.0, radius=1.0)  # 90 degrees apart in azimuth, 0.8 along the arc
    assert len(heard(high, array(resolution=0.05))) == 1
    assert len(heard(high, array(resolution=0.05, planar=True))) == 2
    mixed = on_circle(0, 2, z=0.0)
    mixed[0, 1, 2] = math.nan  # its height is not known: azimuth counts, and the two have no elevation
    got = heard(mixed, array(resolution=0.05))
    assert np.allclose(got.azimuth, np.radians(1), atol=1e-6)
    assert np.isnan(got.elevation).all()


def slow_merge(units, resolution):
    """Groups by following links, one source after another."""
    groups, left = [], set(range(len(units)))
    while left:
        todo, group = [min(left)], set()
        while todo:
            i = todo.pop()
            group.add(i)
            left.discard(i)
            todo += [j for j in sorted(left) if math.acos(min(1.0, units[i] @ units[j])) < resolution]
        total = sum(units[i] for i in sorted(group))
        groups.append(total / np.linalg.norm(total))
    return np.array(groups)


@pytest.mark.parametrize("seed", range(20))
def test_merging_is_that_of_following_links(seed):
    rng = np.random.default_rng(seed)
    places = rng.normal(size=(1, 25, 3))
    got = heard(places, array(resolution=0.3))
    flat = np.cos(got.elevation)
    got_units = np.column_stack([flat * np.cos(got.azimuth), flat * np.sin(got.azimuth), np.sin(got.elevation)])
    want = slow_merge(places[0] / np.linalg.norm(places[0], axis=1, keepdims=True), 0.3)
    assert len(got) == len(want)
    assert np.abs(got_units[:, None] - want[None]).sum(axis=-1).min(axis=0).max() < 1e-6


def test_many_sources_and_times_are_those_of_each_time():
    rng = np.random.default_rng(2)
    places = rng.normal(size=(30, 200, 3))  # more pairs than are compared at a time
    got = heard(places, array(resolution=0.1), SoundConfig(label_doa=True))
    for t in (0, 17, 29):
        alone = heard(places[t : t + 1], array(resolution=0.1), SoundConfig(label_doa=True))
        assert got.source_id[got.t_ns == t * 10**9].tolist() == alone.source_id.tolist()
        assert np.allclose(got.azimuth[got.t_ns == t * 10**9], alone.azimuth, atol=1e-7)


def test_scripted_silence_is_from_up_to():
    positions = np.tile(on_circle(0.0, 90.0), (10, 1, 1))
    got = heard(positions, array(), SoundConfig(label_doa=True), silent={1: np.array([[2, 4], [7, 20]]) * 10**9})
    assert (got.t_ns[got.source_id == 1] // 10**9).tolist() == [0, 1, 4, 5, 6]
    assert (got.source_id == 0).sum() == 10


def test_random_silence_has_its_means_whatever_the_chunks_and_is_one_for_all_arrays():
    n, steps, means = 200, 2000, (6.0, 2.0)
    positions = np.tile(np.ones((1, n, 3)), (steps, 1, 1))
    sound = SoundConfig(sound_and_silence_s=means, label_doa=True)
    got = heard(positions, array(), sound)
    on = np.zeros((steps, n), dtype=bool)
    on[got.t_ns // 10**9, got.source_id] = True
    # correlation time 1 / (1/6 + 1/2) = 1.5 s, so that a second's sample counts for tanh(1 / 3) = 0.32 of one
    error = math.sqrt(0.75 * 0.25 / (n * steps * 0.32))
    assert abs(on.mean() - 0.75) < 4 * error
    assert abs(on[0].mean() - 0.75) < 4 * math.sqrt(0.75 * 0.25 / n)  # from the start on
    stay = on[1:][on[:-1]].mean()
    want = 0.75 + 0.25 * math.exp(-(1 / 6 + 1 / 2))
    assert abs(stay - want) < 4 * math.sqrt(want * (1 - want) / on[:-1].sum())
    grid = grid_of(positions[:300, :5])
    halves = [grid._replace(t_ns=grid.t_ns[s], xyz=grid.xyz[s]) for s in (slice(0, 123), slice(123, None))]
    scene = Scene(arrays=(array(), MicrophoneArray("other", np.zeros(3), rate_hz=0.5)))
    split = Doa.concat(observe_arrays(scene, halves, ObserveConfig(), 3, sound))
    first, second = (split.take(split.sensor == s) for s in ("mic", "other"))
    assert [*zip(first.t_ns, first.source_id, strict=True)] == [
        (t, i) for t, i in zip(got.t_ns, got.source_id, strict=True) if t < 300 * 10**9 and i < 5
    ]
    both = {*zip(first.t_ns.tolist(), first.source_id.tolist(), strict=True)}
    slow = {*zip(second.t_ns.tolist(), second.source_id.tolist(), strict=True)}
    assert slow == {(t, i) for t, i in both if t % (2 * 10**9) == 0}


def test_false_directions_are_poisson_in_number_and_even_on_the_sphere():
    steps, rate = 20_000, 0.7
    empty = np.full((steps, 1, 3), np.nan)
    got = heard(empty, array(rate_hz=None), SoundConfig(false_alarm_rate=rate, step_s=0.5))
    n = rate * 0.5 * steps
    assert abs(len(got) - n) < 4 * math.sqrt(n)
    counts = np.bincount(got.t_ns // 10**9, minlength=steps)
    # Poisson: the variance is the mean; its relative error is sqrt((2 + 1 / mean) / steps)
    assert abs(counts.var() / 0.35 - 1) < 4 * math.sqrt((2 + 1 / 0.35) / steps)
    for even in (got.azimuth / np.pi, np.sin(got.elevation)):
        assert abs(even.mean()) < 4 / math.sqrt(3 * n)
        assert abs(even.var() * 3 - 1) < 4 * math.sqrt(0.8 / n)
    assert (got.source_id == -1).all()
    flat = heard(empty, array(planar=True), SoundConfig(false_alarm_rate=rate, step_s=0.5))
    unknown = heard(empty, array(), SoundConfig(false_alarm_rate=rate, step_s=0.5, known_heights=False))
    assert len(flat) == len(unknown) == len(got)
    assert np.isnan(flat.elevation).all()
    assert np.isnan(unknown.elevation).all()


def test_what_is_asked_for_in_addition_leaves_the_noise_alone():
    positions = np.tile(on_circle(0.0, 90.0, z=1.0), (50, 1, 1))
    plain = heard(positions, array(sigma=0.1), SoundConfig(label_doa=True))
    more = heard(
        positions, array(sigma=0.1), SoundConfig(label_doa=True, false_alarm_rate=0.5, sound_and_silence_s=(5.0, 5.0))
    )
    real = more.take(more.source_id >= 0)
    rows = np.flatnonzero(np.isin(plain.t_ns * 2 + plain.source_id, real.t_ns * 2 + real.source_id))
    assert 20 < len(real) < 80 < len(plain)
    assert (more.source_id == -1).sum() > 5
    assert np.array_equal(plain.azimuth[rows], real.azimuth)


POSES = [(0.0, 0.0, 0.0), (0.7, 0.5, -0.4), (2.0, -1.2, 0.3), (-1.0, 0.0, np.pi / 2), (0.3, 0.0, np.pi)]


@pytest.mark.parametrize("pose", POSES)
def test_noise_is_that_of_the_angles_about_the_arrays_own_axes(pose):
    """Azimuth and polar angle in the array's frame, from the world angles: mean, variance, correlation."""
    n, sigmas = 20_000, (0.05, 0.02)
    yaw, pitch, roll = pose
    ear = array(yaw=yaw, pitch=pitch, roll=roll, sigma=sigmas[0], sigma_elevation=sigmas[1])
    rotation = array_rotation(yaw, pitch, roll)
    own = np.array([-0.6, 0.5, 0.4])  # far from the array's poles
    got = heard(np.tile(rotation @ own * 3.0, (n, 1, 1)), ear)
    assert len(got) == n
    flat = np.cos(got.elevation)
    world = np.column_stack([flat * np.cos(got.azimuth), flat * np.sin(got.azimuth), np.sin(got.elevation)])
    back = world @ rotation
    errors = (
        wrap_angle(np.arctan2(back[:, 1], back[:, 0]) - np.arctan2(own[1], own[0])),
        np.arccos(back[:, 2]) - math.acos(own[2] / np.linalg.norm(own)),
    )
    for error, sigma in zip(errors, sigmas, strict=True):
        assert abs(error.mean()) < 4 * sigma / math.sqrt(n)
        assert abs(error.std() / sigma - 1) < 4 / math.sqrt(2 * n)
    assert abs(np.corrcoef(*errors)[0, 1]) < 4 / math.sqrt(n)
    assert (got.sigma_azimuth == sigmas[0]).all()
    assert (got.sigma_elevation == sigmas[1]).all()


@pytest.mark.parametrize("pose", [(0.0, 0.0, 0.0), (0.4, 0.9, 0.2)])
def test_near_the_pole_directions_come_down_on_its_other_side(pose):
    """Against the definition drawn by other random numbers: unit vectors of theta + n1, phi + n2."""
    n, sigma = 20_000, 0.1
    rotation = array_rotation(*pose)
    phi, theta = 0.05, 1.0
    own = np.array([math.sin(phi) * math.cos(theta), math.sin(phi) * math.sin(theta), math.cos(phi)])
    ear = array(yaw=pose[0], pitch=pose[1], roll=pose[2], sigma=sigma)
    got = heard(np.tile(rotation @ own * 7.0, (n, 1, 1)), ear)
    flat = np.cos(got.elevation)
    units = np.column_stack([flat * np.cos(got.azimuth), flat * np.sin(got.azimuth), np.sin(got.elevation)]) @ rotation
    rng = np.random.default_rng(11)
    p, q = phi + sigma * rng.standard_normal(n), theta + sigma * rng.standard_normal(n)
    want = np.column_stack([np.sin(p) * np.cos(q), np.sin(p) * np.sin(q), np.cos(p)])
    over = (p < 0).mean()
    assert 0.25 < over < 0.37  # of a normal distribution: 0.31
    for axis in range(3):
        error = math.sqrt((units[:, axis].var() + want[:, axis].var()) / n)
        assert abs(units[:, axis].mean() - want[:, axis].mean()) < 4 * error
        spread = [((x[:, axis] - want[:, axis].mean()) ** 2) for x in (units, want)]
        error = math.sqrt((spread[0].var() + spread[1].var()) / n)
        assert abs(spread[0].mean() - spread[1].mean()) < 4 * error
    assert (np.abs(got.elevation) <= np.pi / 2).all()
    assert (np.abs(got.azimuth) <= np.pi).all()


def test_range_is_in_space():
    positions = np.array([[[3.0, 0.0, 3.9], [3.0, 0.0, 4.1], [5.01, 0.0, math.nan]]])
    got = heard(positions, array(range=5.0), SoundConfig(label_doa=True))
    assert got.source_id.tolist() == [0]


def test_merged_directions_are_missed_as_one():
    positions = np.tile(on_circle(10.0, 11.0), (4000, 1, 1))
    got = heard(positions, array(resolution=0.1), miss=0.3)
    assert abs(len(got) / 4000 - 0.7) < 4 * math.sqrt(0.21 / 4000)


def test_tilted_arrays_need_heights_and_planar_ones_an_upright_axis():
    flat = on_circle(10.0, z=math.nan)
    with pytest.raises(InputError, match="mic is tilted and hears a target of unknown height"):
        heard(flat, array(pitch=0.1))
    with pytest.raises(InputError, match="mic is planar and tilted"):
        heard(flat, array(pitch=0.1, planar=True))
    down = heard(flat, array(roll=np.pi, planar=True))  # at the ceiling, upside down
    assert np.allclose(down.azimuth, np.radians(10.0))


def test_settings_that_are_none():
    for values in (
        {"sound_and_silence_s": (0.0, 1.0)},
        {"sound_and_silence_s": (1.0, math.inf)},
        {"false_alarm_rate": -1.0},
        {"step_s": 0.0},
    ):
        with pytest.raises(InputError, match=f"sound: {next(iter(values))} is"):
            SoundConfig(**values)
