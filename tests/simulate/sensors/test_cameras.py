import numpy as np
import pytest
from shapely.geometry import LineString, Point, Polygon

from occlog.core.geometry.camera import noise_variance, planar_offsets, rotation_from_angles, wrap_angle
from occlog.errors import InputError
from occlog.records.scene import Camera, Occluder, Scene
from occlog.records.tables import Bearings, Truth
from occlog.simulate.config import ObserveConfig
from occlog.simulate.sensors.cameras import observe

ROOM = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 100.0], [0.0, 100.0]])
PILLAR = Occluder("pillar", np.array([[40.0, 40.0], [60.0, 40.0], [60.0, 60.0], [40.0, 60.0]]))


def camera(name="a", xy=(0.0, 0.0), yaw_deg=45.0, **values):
    settings = {"sigma_position": 1.0, "sigma_yaw": 0.01, "sigma_read_px": 2.0} | values
    return Camera(
        name,
        np.array([*xy, 0.0]),
        rotation_from_angles(np.radians(yaw_deg), 0.0, 0.0),
        np.array([70.0, 70.0]),
        np.zeros(2),
        **settings,
    )


def truth_of(xy, role=None, step_ns=10**9):
    """Table of (T, n, 2) places; by default object 0 is the target."""
    t, n = xy.shape[:2]
    role = role or ["target"] + ["occluder"] * (n - 1)
    return Truth.of(
        t_ns=np.repeat(np.arange(t) * step_ns, n),
        target_id=np.tile(np.arange(n, dtype=np.int32), t),
        role=np.tile(role, t),
        x=xy[..., 0].ravel(),
        y=xy[..., 1].ravel(),
        z=np.full(t * n, np.nan),
    )


def seen_by(scene, xy, config=None, seed=1, role=None):
    return Bearings.concat(observe(scene, [truth_of(xy, role)], config or ObserveConfig(), seed))


def random_places(seed, steps, n):
    return np.random.default_rng(seed).uniform(0, 100, (steps, n, 2))


def test_visibility_agrees_with_shapely():
    scene = Scene(cameras=(camera(range=90.0),), room=ROOM, occluders=(PILLAR,), length_unit="unit")
    xy = random_places(0, 600, 12)
    got = seen_by(scene, xy)
    pillar, want = Polygon(PILLAR.polygon), []
    for x, *others in xy:
        line = LineString([(0, 0), x])
        disc = line.buffer(3.33 / 2, cap_style="flat")
        free = line.length <= 90 and line.intersection(pillar).length < 1e-9
        want.append(free and not any(disc.contains(Point(o)) for o in others))
    assert got.seen.tolist() == want
    assert 0.2 < np.mean(want) < 0.6


def test_walls_of_a_bent_room_hide():
    room = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 30.0], [30.0, 30.0], [30.0, 100.0], [0.0, 100.0]])
    scene = Scene(cameras=(camera(xy=(100.0, 0.0), yaw_deg=180.0, fov=np.pi),), room=room, length_unit="unit")
    positions = np.array([[[10.0, 10.0]], [[10.0, 95.0]]])
    assert seen_by(scene, positions).seen.tolist() == [True, False]


@pytest.mark.parametrize("place", [(30.0, 20.0), (5.0, 60.0)])
def test_white_noise_has_the_variance_of_eq_2(place):
    """20,000 frames of a target that stands still: mean and variance of z within 4 standard errors."""
    n, cam = 20_000, camera(yaw_deg=60.0)
    got = seen_by(Scene(cameras=(cam,), length_unit="unit"), np.tile(place, (n, 1, 1)))
    h, d = planar_offsets(np.array([place]), cam.ground, cam.yaw)
    variance = noise_variance(h, d, 70.0, 1.0, 0.01, 2.0)[0]
    z = -got.u_px
    assert abs(z.mean() - 70 * h[0] / d[0]) < 4 * np.sqrt(variance / n)
    assert abs(z.var() / variance - 1) < 4 * np.sqrt(2 / n)
    assert abs(np.corrcoef(z[1:], z[:-1])[0, 1]) < 4 / np.sqrt(n)
    assert (got.sigma_px == 2.0).all()
    assert got.bearing == pytest.approx(cam.yaw + np.arctan(z / 70.0))


def test_sigma_is_the_spread_of_the_bearing():
    """At small noise the stated sigma is the standard deviation of bearing minus true azimuth."""
    n, place = 20_000, np.array([30.0, 12.0])
    cam = camera(sigma_position=0.1, sigma_yaw=0.002, sigma_read_px=0.2)
    got = seen_by(Scene(cameras=(cam,), length_unit="unit"), np.tile(place, (n, 1, 1)))
    error = wrap_angle(got.bearing - np.arctan2(place[1], place[0]))
    assert abs(error.std() / got.sigma.mean() - 1) < 4 / np.sqrt(2 * n)


def test_calibration_errors_stay_and_have_the_stated_size():
    """500 cameras: the mean z of each is off by one draw; only the read noise changes from frame to frame."""
    place, n = np.array([30.0, 20.0]), 50
    cams = tuple(camera(f"c{i}") for i in range(500))
    scene = Scene(cameras=cams, length_unit="unit")
    got = seen_by(scene, np.tile(place, (n, 1, 1)), ObserveConfig(pose_noise="calibration"))
    z = -got.u_px.reshape(n, 500)
    h, d = planar_offsets(place[None], cams[0].ground, cams[0].yaw)
    fixed = noise_variance(h, d, 70.0, 1.0, 0.01, 0.0)[0]
    assert abs(z.var(axis=0, ddof=1).mean() / 4.0 - 1) < 4 * np.sqrt(2 / (n * 500))
    means = z.mean(axis=0)
    assert abs(means.var() / (fixed + 4.0 / n) - 1) < 4 * np.sqrt(2 / 500)


def test_looked_and_not_seen_has_a_row_and_no_value():
    scene = Scene(cameras=(camera(yaw_deg=-135.0),), length_unit="unit")
    got = seen_by(scene, random_places(0, 5, 1))
    assert len(got) == 5
    assert not got.seen.any()
    assert np.isnan(got.bearing).all()
    assert np.isnan(got.u_px).all()


def test_cameras_deliver_at_their_own_rates():
    scene = Scene(cameras=(camera("a", rate_hz=2.5), camera("b")), length_unit="unit")
    xy = np.linspace([10.0, 10.0], [50.0, 10.0], 9)[:, None]  # 5 units a second
    got = seen_by(scene, xy)
    a, b = got.take(got.sensor == "a"), got.take(got.sensor == "b")
    assert a.t_ns.tolist() == [k * 400_000_000 for k in range(21)]
    assert b.t_ns.tolist() == [k * 10**9 for k in range(9)]
    true = np.arctan2(10.0, 10.0 + 5.0 * a.t_ns * 1e-9)
    assert np.all(np.abs(wrap_angle(a.bearing - true)) < 5 * a.sigma)


def test_targets_hide_each_other_and_discs_can_be_switched_off():
    scene = Scene(cameras=(camera(),), length_unit="unit")
    xy = np.tile([[10.0, 10.0], [30.0, 30.0], [12.0, 40.0]], (3, 1, 1))
    got = seen_by(scene, xy, role=["target", "target", "occluder"])
    assert got.target_id.tolist() == [0, 1] * 3
    assert got.seen.tolist() == [True, False] * 3
    assert seen_by(scene, xy, ObserveConfig(diameter=0.0), role=["target"] * 3).seen.all()


def test_misses_and_false_alarms_have_their_probability():
    n, scene = 4000, Scene(cameras=(camera(),), length_unit="unit")
    position = np.tile([40.0, 40.0], (n, 1, 1))
    missed = ~seen_by(scene, position, ObserveConfig(miss_probability=0.3)).seen
    assert abs(missed.mean() - 0.3) < 4 * np.sqrt(0.21 / n)
    behind = -position
    false = seen_by(scene, behind, ObserveConfig(false_alarm_probability=0.2))
    assert abs(false.seen.mean() - 0.2) < 4 * np.sqrt(0.16 / n)
    z = false.u_px[false.seen]
    assert np.abs(z).max() <= 70.0
    assert abs(z.mean()) < 4 * 70 / np.sqrt(3 * len(z))


def test_chunks_do_not_change_what_is_measured():
    scene = Scene(cameras=(camera("a", rate_hz=1.7), camera("b")), room=ROOM, length_unit="unit")
    table = truth_of(random_places(3, 60, 4))
    config = ObserveConfig(miss_probability=0.1, false_alarm_probability=0.1)
    whole = Bearings.concat(observe(scene, [table], config, 2))
    parts = [table.take(slice(0, 40)), table.take(slice(40, 44)), table.take(slice(44, None))]
    cut = Bearings.concat(observe(scene, parts, config, 2))
    for column in Bearings.columns():
        a, b = getattr(whole, column.name), getattr(cut, column.name)
        assert np.array_equal(a, b, equal_nan=a.dtype.kind == "f")


def test_a_camera_keeps_its_noise_when_others_are_added():
    xy = random_places(4, 30, 1)
    alone = seen_by(Scene(cameras=(camera("a"),), length_unit="unit"), xy)
    both = seen_by(Scene(cameras=(camera("a"), camera("b")), length_unit="unit"), xy)
    assert np.array_equal(both.u_px[both.sensor == "a"], alone.u_px, equal_nan=True)
    assert not np.array_equal(both.u_px[both.sensor == "b"], alone.u_px, equal_nan=True)


def test_a_camera_without_pose_is_left_out():
    scene = Scene(cameras=(camera("a"), camera("b", placed=False)), length_unit="unit")
    assert set(seen_by(scene, random_places(0, 3, 1)).sensor) == {"a"}


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"miss_probability": 2.0}, "miss_probability is 2.0"),
        ({"pose_noise": "pink"}, "pose_noise is pink, must be one of white, calibration"),
        ({"diameter": -1.0}, "diameter is -1.0"),
    ],
)
def test_impossible_values_are_reported_by_observe(values, says):
    with pytest.raises(InputError, match=says):
        ObserveConfig(**values)


def test_a_cameras_own_probabilities_come_before_the_configuration():
    n, scene = 4000, Scene(cameras=(camera(detection=0.6, false_alarm=0.0),), length_unit="unit")
    position = np.tile([40.0, 40.0], (n, 1, 1))
    seen = seen_by(scene, position, ObserveConfig(miss_probability=0.0, false_alarm_probability=1.0)).seen
    assert abs(seen.mean() - 0.6) < 4 * np.sqrt(0.24 / n)
