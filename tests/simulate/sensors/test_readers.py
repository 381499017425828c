"""What simulated readers of tags read."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.array_types import NS
from occlog.core.numerics.interpolate import TimeGrid
from occlog.records.scene import Scene, TagReader
from occlog.records.tables import Reads
from occlog.simulate.config import ReadConfig
from occlog.simulate.sensors.stations import observe_readers

SURE = ReadConfig(read_detection_probability=1.0, read_false_alarm_probability=0.0, noise_db=0.0, shadow_db=0.0)


def grid(places: list[list[tuple[float, float, float]]], step_s: float = 1.0) -> TimeGrid:
    """Targets 3 and 12 at (T, 2) places, and an occluder at the origin."""
    xyz = np.array([[*row, (0.0, 0.0, 1.0)] for row in places])
    t_ns = np.rint(np.arange(len(places)) * step_s * NS).astype(np.int64)
    return TimeGrid(t_ns, np.array([3, 12, 20]), np.array([True, True, False]), xyz)


def scene(**own: object) -> Scene:
    """One reader at the origin, 2 m up."""
    return Scene(readers=(TagReader("door", np.array([0.0, 0.0, 2.0]), **own),), length_unit="m")  # type: ignore[arg-type]


def read(where: Scene, config: ReadConfig, *chunks: TimeGrid, seed: int = 0) -> Reads:
    return Reads.concat(list(observe_readers(where, chunks, config, seed)))


def test_a_reader_reads_the_tags_in_its_range_on_the_floor_and_no_occluder() -> None:
    at_the_end, beyond = (3.0, 0.0, 1.0), (3.0 + 1e-9, 0.0, 1.0)
    found = read(scene(range=3.0), SURE, grid([[at_the_end, beyond], [beyond, at_the_end]]))
    assert found.t_ns.tolist() == [0, NS]
    assert found.target_id.tolist() == [3, 12]
    assert found.tag.tolist() == ["3", "12"]
    assert set(found.sensor.tolist()) == {"door"}


def test_strength_falls_with_the_distance_in_space_and_begins_with_the_reader_s_own_power() -> None:
    # 3-4-5: the tag is 3 m away on the floor and 4 m below.
    positions = grid([[(3.0, 0.0, -2.0), (0.0, 0.0, 1.0)]])
    usual = read(scene(), SURE, positions)
    assert usual.tag.tolist() == ["12", "3"]
    np.testing.assert_allclose(usual.rssi, [-60.0, -60.0 - 20.0 * np.log10(5.0)])
    own = read(scene(power=-50.0), SURE, positions)
    np.testing.assert_allclose(own.rssi, usual.rssi + 10.0)
    steep = read(
        scene(),
        ReadConfig(read_detection_probability=1.0, noise_db=0.0, shadow_db=0.0, path_loss_exponent=3.0),
        positions,
    )
    np.testing.assert_allclose(steep.rssi, [-60.0, -60.0 - 30.0 * np.log10(5.0)])


def test_a_length_in_feet_is_read_at_its_distance_in_metres() -> None:
    where = Scene(readers=(TagReader("door", np.zeros(3)),), length_unit="ft")
    found = read(where, SURE, grid([[(10.0, 0.0, 0.0), (0.0, 1.0, 0.0)]]))
    np.testing.assert_allclose(found.rssi, -60.0 - 20.0 * np.log10(np.array([0.3048, 3.048])))


def test_a_tag_of_unknown_height_is_on_the_floor_and_one_that_is_not_there_is_not_read() -> None:
    found = read(scene(), SURE, grid([[(0.0, 0.0, np.nan), (np.nan, np.nan, np.nan)]]))
    assert found.target_id.tolist() == [3]
    assert found.rssi[0] == pytest.approx(-60.0 - 20.0 * np.log10(2.0))


def test_weak_signals_are_not_read() -> None:
    positions = grid([[(3.0, 0.0, -2.0), (0.0, 0.0, 1.0)]])
    exactly = ReadConfig(read_detection_probability=1.0, noise_db=0.0, shadow_db=0.0, min_rssi_dbm=-60.0)
    assert read(scene(), exactly, positions).target_id.tolist() == [12]


def test_reads_have_the_stated_probabilities_noise_and_shadowing() -> None:
    # One tag in range, one out of it, looked at every second.
    positions = grid([[(1.0, 0.0, 2.0), (9.0, 0.0, 2.0)]] * 4000)
    config = ReadConfig(
        read_detection_probability=0.8, read_false_alarm_probability=0.1, noise_db=2.0, shadow_db=3.0, shadow_s=4.0
    )
    found = read(scene(range=3.0), config, positions)
    shares = [np.mean(np.isin(positions.t_ns, found.t_ns[found.target_id == n])) for n in (3, 12)]
    np.testing.assert_allclose(shares, [0.8, 0.1], atol=0.02)
    sure = read(
        scene(range=3.0),
        ReadConfig(read_detection_probability=1.0, noise_db=2.0, shadow_db=3.0, shadow_s=4.0),
        positions,
    )
    level = sure.rssi[sure.target_id == 3] + 60.0
    assert np.var(level) == pytest.approx(2.0**2 + 3.0**2, rel=0.1)
    # White noise is not in the covariance of neighbours; shadowing falls by exp(-1 / 4) a second.
    assert np.mean(level[1:] * level[:-1]) == pytest.approx(9.0 * np.exp(-0.25), rel=0.15)
    assert np.mean(level[4:] * level[:-4]) == pytest.approx(9.0 * np.exp(-1.0), rel=0.3)


def test_chunks_do_not_change_what_is_read_and_a_rate_of_its_own_is_kept() -> None:
    positions = grid([[(1.0 + 0.1 * k, 0.0, 2.0), (2.0, 0.0, 2.0)] for k in range(8)])
    config = ReadConfig(read_detection_probability=0.9)
    whole = read(scene(rate_hz=2.0), config, positions, seed=5)
    assert set(np.diff(np.unique(whole.t_ns)).tolist()) <= {NS // 2, NS}
    parts = [positions._replace(t_ns=positions.t_ns[s], xyz=positions.xyz[s]) for s in (slice(0, 3), slice(3, 8))]
    split = read(scene(rate_hz=2.0), config, *parts, seed=5)
    assert split.t_ns.tolist() == whole.t_ns.tolist()
    np.testing.assert_allclose(split.rssi, whole.rssi)


def test_a_tag_that_comes_later_has_a_shadowing_of_its_own() -> None:
    both = grid([[(1.0, 0.0, 2.0), (1.0, 0.0, 2.0)]] * 6)
    alone = TimeGrid(both.t_ns[:3], both.ids[[0, 2]], both.target[[0, 2]], both.xyz[:3][:, [0, 2]])
    later = both._replace(t_ns=both.t_ns[3:], xyz=both.xyz[3:])
    still = ReadConfig(read_detection_probability=1.0, noise_db=0.0, shadow_db=3.0, shadow_s=1e12)
    found = read(scene(), still, alone, later)
    first, second = (found.rssi[found.target_id == n] for n in (3, 12))
    assert (len(first), len(second)) == (6, 3)
    # Shadowing that lasts stays as it was for the tag that was there, and is another one for the tag that comes.
    np.testing.assert_allclose(first, first[0], atol=1e-4)
    np.testing.assert_allclose(second, second[0], atol=1e-4)
    assert abs(first[0] - second[0]) > 0.1
