"""A sensor that is turned, or of which the clock is late, is named with the size of its error; clean ones are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.track._metric_rooms import Recording, record, room
from occlog.array_types import Floats
from occlog.consistency.bearings import StatedResiduals
from occlog.consistency.systematic_errors import LATE, TURNED, SystematicErrors
from occlog.core.geometry.camera import wrap_angle
from occlog.records.tables import Bearings, Tracks
from occlog.records.verdicts import Check, findings
from occlog.settings import configure
from occlog.track.catalogue import settings_of
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.run import TrackSummary

NS = 1_000_000_000
SIGMA = 0.01
SCENE = room(4, 600.0, 3.0)


def path_of(seconds: Floats) -> Floats:
    """A target on a circle of 2.5 m in 25 s."""
    angle = 2.0 * np.pi * seconds / 25.0
    return np.column_stack([5.0 + 2.5 * np.cos(angle), 4.0 + 2.5 * np.sin(angle)])


def collected(
    seed: int, *, yaw: float = 0.0, late_s: float = 0.0, sensors: int = 4, noise: float = 1.0
) -> SystematicErrors:
    """Bearings of 40 s at 5 Hz, at estimates with an error that changes slowly.

    Those of cam2 have an error of yaw or clock, or `noise` times the stated standard deviation.
    """
    rng = np.random.default_rng([4500, seed])
    seconds = np.arange(200) / 5.0
    t_ns = np.round(seconds * NS).astype(np.int64)
    slow = np.cumsum(rng.standard_normal((200, 2)), axis=0) * 0.005
    estimates = path_of(seconds) + slow
    nothing = np.full(200, 0.01)
    tracks = Tracks.of(
        t_ns=t_ns, target_id=np.zeros(200, dtype=np.int32), x=estimates[:, 0], y=estimates[:, 1],
        vx=nothing, vy=nothing, cov_xx=nothing, cov_xy=0.0 * nothing, cov_yy=nothing,
    )  # fmt: skip
    stated = []
    for n, camera in enumerate(SCENE.cameras[:sensors]):
        off = n == 1
        seen = path_of(seconds - (late_s if off else 0.0)) - camera.position[:2]
        bearing = np.arctan2(seen[:, 1], seen[:, 0]) + (yaw if off else 0.0)
        bearing += (noise if off else 1.0) * SIGMA * rng.standard_normal(200)
        away = estimates - camera.position[:2]
        residual = wrap_angle(bearing - np.arctan2(away[:, 1], away[:, 0])) / SIGMA
        keep = rng.random(200) >= 0.3
        far = np.zeros(keep.sum(), dtype=np.bool_)
        stated.append(StatedResiduals(0, camera.name, t_ns[keep], residual[keep], np.full(keep.sum(), SIGMA), far))
    found = SystematicErrors(SCENE)
    found.add(tracks, stated)
    return found


def test_sizes_are_right_within_their_errors() -> None:
    """Over 10 recordings of each error the mean of the size is within 4 of its standard errors, or 5 % of the size."""
    turned, late = [], []
    for seed in range(10):
        for found, kind, sizes in (
            (collected(seed, yaw=0.02).found(), TURNED, turned),
            (collected(seed, late_s=0.2).found(), LATE, late),
        ):
            assert (found[0].sensor, found[0].kind) == ("cam2", kind)
            sizes.append((found[0].size, found[0].error))
    for sizes, size in ((turned, 0.02), (late, 0.2)):
        values, errors = np.array(sizes).T
        assert abs(values.mean() - size) < 4.0 * errors.mean() / np.sqrt(10) + 0.05 * size
        assert 0.5 < values.std() / errors.mean() < 2.0


@pytest.mark.statistics
def test_sensors_without_an_error_are_not_named() -> None:
    """20 recordings; the probability of a finding in any is 0.02 by the stated significance."""
    assert sum(bool(collected(seed).found()) for seed in range(20)) <= 1


def test_two_sensors_leave_nothing_to_be_found_which_is_reported() -> None:
    for seed in range(10):
        found = collected(seed, yaw=0.02, sensors=2)
        assert not found.found()
        (note,) = findings(found.checks())
        assert (note.id, note.severity, note.sensors) == ("sensors-unverified", "note", ("cam1", "cam2"))
    assert not findings(collected(0, sensors=3).checks())


@pytest.mark.parametrize("sensors", [2, 3, 4])
def test_a_sensor_with_three_times_the_stated_noise_is_named(sensors: int) -> None:
    factors = []
    for seed in range(6):
        noisy = collected(seed, noise=3.0, sensors=sensors).noisy()
        assert [name for name, _ in noisy] == ["cam2"]
        factors.append(noisy[0][1])
    assert 2.4 < np.mean(factors) < 3.6


@pytest.mark.statistics
@pytest.mark.parametrize("sensors", [2, 4])
def test_noise_as_stated_is_not_reported(sensors: int) -> None:
    """Variances have a mean of 1: the quiet windows are not taken for all."""
    found = [collected(seed, sensors=sensors) for seed in range(20)]
    assert not any(one.noisy() for one in found)
    variances = np.array([one._noise.variances()[0] for one in found])[:, :sensors]
    assert 0.9 < variances.mean() < 1.2


def test_noise_is_not_judged_where_a_sensor_is_turned() -> None:
    ids = [check.id for check in findings(collected(1, yaw=0.05).checks())]
    assert "sensor-turned" in ids
    assert "sensor-noise-small" not in ids


def test_stated_errors_of_poses_are_no_finding() -> None:
    found = collected(1, yaw=0.02)
    found._sensors["cam2"] = replace(found._sensors["cam2"], sigma_yaw=0.01)
    assert not found.found()


def said_of(
    made: Recording, bearings: Bearings, method: str, ids: tuple[str, ...] = ("sensor-turned", "sensor-late")
) -> list[Check]:
    """Findings of these ids: of a sensor's errors."""
    config = configure(settings_of(method).in_unit("m"), {})
    summary = TrackSummary(made.scene, joint=False)
    for part in track([bearings], made.scene, TrackingTask(config, 0, method=method)):
        summary.add(part)
    return [check for check in findings(summary.checks()) if check.id in ids]


@pytest.mark.jit
@pytest.mark.parametrize(
    "method", ["ekf", *(pytest.param(name, marks=pytest.mark.statistics) for name in ("apf", "fix", "map"))]
)
def test_every_method_names_the_sensor(method: str) -> None:
    made = record("walk", 4, seed=700)
    own = made.bearings.sensor == "cam2"
    assert not said_of(made, made.bearings, method)
    # A yaw of 1 degree
    yaw, f = made.scene.cameras[1].yaw, 600.0
    bearing = made.bearings.bearing + np.where(own, np.radians(1.0), 0.0)
    u_px = np.where(own, -f * np.tan(bearing - yaw), made.bearings.u_px)
    turned = said_of(made, replace(made.bearings, bearing=wrap_angle(bearing), u_px=u_px), method)
    assert (turned[0].id, turned[0].sensors) == ("sensor-turned", ("cam2",))
    assert abs(turned[0].figures["size"] - 1.0) < 0.25
    # A clock that is 0.2 s late
    t_ns = made.bearings.t_ns + np.where(own, NS // 5, 0)
    order = np.lexsort((made.bearings.sensor, t_ns))
    columns = {c.name: getattr(made.bearings, c.name)[order] for c in Bearings.columns()}
    late = said_of(made, Bearings(**columns | {"t_ns": t_ns[order]}), method)
    assert (late[0].id, late[0].sensors) == ("sensor-late", ("cam2",))
    assert abs(late[0].figures["size"] - 0.2) < 0.05
    assert "too large (allowed" in late[0].text
    assert abs(float(late[0].text.rpartition("=")[2]) + 0.2) < 0.05


@pytest.mark.jit
@pytest.mark.parametrize(
    "method", ["ekf", *(pytest.param(name, marks=pytest.mark.statistics) for name in ("apf", "fix", "map"))]
)
def test_every_method_names_the_sensor_with_noise_stated_too_small(method: str) -> None:
    made = record("walk", 4, miss=0.1, seed=701)
    own = made.bearings.sensor == "cam2"
    assert not said_of(made, made.bearings, method, ("sensor-noise-small",))
    less = {name: np.where(own, 1.0 / 3.0, 1.0) * getattr(made.bearings, name) for name in ("sigma", "sigma_px")}
    (found,) = said_of(made, replace(made.bearings, **less), method, ("sensor-noise-small",))
    assert found.sensors == ("cam2",)
    assert 2.0 < found.figures["factor"] < 4.0
