"""Measurements of distances as scans: units, speed, path loss, heights, windows, and what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest

from occlog.errors import InputError
from occlog.filtering.likelihood.distances import DIFFERENCE, LOGARITHM, RANGE
from occlog.records.declared.sensors import Measurements
from occlog.records.scene import Camera, MicrophoneArray, Scene, TagReader, camera_rotation
from occlog.records.tables import Reads
from occlog.scans.config import DistanceMeasurementConfig
from occlog.scans.distance_measurements import (
    DistanceMeasurementFeed,
    Radio,
    SignalErrors,
    make_stations,
    measurements_of_reads,
    pack,
)
from occlog.scans.grouping import Scan


def scene(unit: str = "m", z: float = 0.0) -> Scene:
    blind = Camera("eye", np.zeros(3), camera_rotation(0, 0, 0), np.full(2, 500.0), np.zeros(2), placed=False)
    arrays = (MicrophoneArray("a", np.array([0.0, 0.0, z])), MicrophoneArray("b", np.array([4.0, 3.0, z])))
    return Scene(
        cameras=(blind,),
        arrays=arrays,
        readers=(TagReader("r", np.array([1.0, 1.0, z]), power=-50.0),),
        length_unit=unit,
    )


def table(**columns: object) -> Measurements:
    n = len(np.atleast_1d(columns["sensor"]))
    nan = np.full(n, np.nan)
    blank = {"range": nan, "sigma_range": nan, "rssi": nan, "sigma_rssi": nan}
    start = {"t_ns": np.arange(n), "target_id": np.zeros(n, dtype=np.int32)}
    return Measurements.of(**(blank | start | columns))


def packed(
    rows: Measurements, config: DistanceMeasurementConfig, where: Scene | None = None, radio: Radio | None = None
):
    at = where or scene()
    return pack(rows, make_stations(at, config, radio), config, radio)


def test_a_row_with_two_values_gives_two_measurements() -> None:
    rows = table(sensor=["b", "a"], range=[np.nan, 2.0], sigma_range=[np.nan, 0.1], rssi=[-60.0, -70.0])
    row, found = packed(rows, DistanceMeasurementConfig())
    assert row.tolist() == [0, 1, 1]
    assert found.kind.tolist() == [LOGARITHM, RANGE, LOGARITHM]
    assert found.position.tolist() == [[4, 3], [0, 0], [0, 0]]


def test_a_time_difference_is_a_length_by_the_stated_speed_in_the_unit_of_the_scene() -> None:
    rows = table(sensor=["a"], reference=["b"], tdoa=[0.01], sigma_tdoa=[1e-3])
    for unit, metre in (("m", 1.0), ("ft", 1 / 0.3048)):
        _, found = packed(rows, DistanceMeasurementConfig(propagation_speed="sound"), scene(unit))
        assert found.kind.tolist() == [DIFFERENCE]
        np.testing.assert_allclose([found.value[0], found.sigma[0]], [3.43 * metre, 0.343 * metre])
        assert found.other.tolist() == [[4, 3]]
    _, found = packed(rows, DistanceMeasurementConfig(propagation_speed="1500"))
    assert found.value[0] == pytest.approx(15.0)
    with pytest.raises(InputError, match="require the speed of propagation"):
        packed(rows, DistanceMeasurementConfig())


@pytest.mark.parametrize("speed", ["warp", "0", "-1", "nan", "1e9"])
def test_a_speed_is_a_number_above_0(speed: str) -> None:
    with pytest.raises(InputError, match="sound, light, or a number above 0"):
        DistanceMeasurementConfig(propagation_speed=speed)


def test_power_is_of_the_file_then_of_the_scene_then_of_the_settings() -> None:
    rows = table(sensor=["a", "r"], rssi=[-60.0, -60.0])
    config = DistanceMeasurementConfig(rssi_power=-40.0, rssi_exponent=2.0, sigma_rssi=6.0)
    _, found = packed(rows, config)
    np.testing.assert_allclose(np.exp(found.value), [10.0, 10**0.5])
    np.testing.assert_allclose(found.sigma, 6.0 * math.log(10) / 20)
    _, found = packed(
        rows, DistanceMeasurementConfig(), radio=Radio({"a": -50.0, "r": -40.0}, 1.0, SignalErrors(3.0, 4.0, 1.0), 0.0)
    )
    np.testing.assert_allclose(np.exp(found.value), [10.0, 100.0])
    np.testing.assert_allclose(found.sigma, 5.0 * math.log(10) / 10)


def test_heights_count_where_that_of_the_targets_is_stated_and_are_refused_where_it_is_not() -> None:
    rows = table(sensor=["a"], range=[3.0], sigma_range=[0.1])
    _, found = packed(rows, DistanceMeasurementConfig(tag_height=0.5), scene(z=2.0))
    assert found.rise2.tolist() == [2.25]
    with pytest.raises(InputError, match="state the height of the targets"):
        packed(rows, DistanceMeasurementConfig(), scene(z=2.0))
    assert packed(rows, DistanceMeasurementConfig())[1].rise2.tolist() == [0.0]


def test_what_cannot_be_used_is_refused_with_its_place() -> None:
    config = DistanceMeasurementConfig(sigma_range=0.1)
    with pytest.raises(InputError, match=r"no station 'aa' \(column sensor\) in the scene; did you mean 'a'"):
        packed(table(sensor=["aa"], range=[1.0]), config)
    with pytest.raises(InputError, match="'eye' has no position in the scene"):
        packed(table(sensor=["eye"], range=[1.0]), config)
    with pytest.raises(InputError, match="range of 'a' at 0 s has no standard deviation"):
        packed(table(sensor=["a"], range=[1.0]), DistanceMeasurementConfig())
    assert packed(table(sensor=["a"], range=[1.0]), config)[1].sigma.tolist() == [0.1]
    with pytest.raises(InputError, match="are of two stations"):
        table(sensor=["a"], reference=["a"], range_difference=[1.0])
    with pytest.raises(InputError, match="has none of range, rssi, tdoa, range_difference"):
        table(sensor=["a"])
    with pytest.raises(InputError, match="sigma_range 0 must be above 0"):
        table(sensor=["a"], range=[1.0], sigma_range=[0.0])


def test_scans_of_both_kinds_are_joined_in_the_order_of_time_wherever_chunks_are_cut() -> None:
    rows = table(sensor=["a", "b", "a", "a", "b"], t_ns=[0, 0, 10, 25, 40], range=[1.0, 2.0, 3.0, 4.0, 5.0])
    directions = [Scan.of(t, [1], target_id=[0], bearing=[0.1]) for t in (10, 20, 40)]
    for cut in range(6):
        feed = DistanceMeasurementFeed(
            [rows.take(slice(None, cut)), rows.take(slice(cut, None))],
            scene(),
            DistanceMeasurementConfig(sigma_range=1.0),
        )
        found = list(feed.joined(iter(directions)))
        assert [s.t_ns for s in found] == [0, 10, 20, 25, 40]
        reported = [[] if s.measured is None else s.measured.distances.value.tolist() for s in found]
        assert reported == [[1, 2], [3], [], [4], [5]]
        assert [len(s.sensor) for s in found] == [0, 1, 1, 0, 1]


def test_within_the_window_measurements_and_directions_are_one_scan_and_beyond_it_two() -> None:
    rows, config = table(sensor=["a"], t_ns=[25], range=[4.0]), DistanceMeasurementConfig(sigma_range=1.0)
    for window, times in ((5, [25]), (4, [20, 25])):
        feed = DistanceMeasurementFeed([rows], scene(), config)
        assert [s.t_ns for s in feed.joined(iter([Scan.of(20, [1])]), window_ns=window)] == times


def test_only_chosen_stations_and_targets_count() -> None:
    rows = table(sensor=["a", "b", "a"], target_id=np.array([0, 0, 7]), range=[1.0, 2.0, 3.0])
    feed = DistanceMeasurementFeed([rows], scene(), DistanceMeasurementConfig(sigma_range=1.0))
    found = list(feed.joined(iter(()), sensors={"a"}, targets=(7,)))
    assert [s.measured.distances.value.tolist() for s in found] == [[3.0]]
    assert found[0].targets == {7}
    assert found[0].of_target(0) is None
    assert found[0].of_target(7).measured.target_id.tolist() == [7]


def test_a_difference_counts_if_both_of_its_stations_do() -> None:
    rows = table(sensor=["a", "b"], reference=["b", "r"], range_difference=[1.0, 2.0], t_ns=[0, 0])
    config = DistanceMeasurementConfig(sigma_range_difference=1.0)
    for without, left in (("a", [2.0]), ("b", []), ("r", [1.0]), ("", [1.0, 2.0])):
        feed = DistanceMeasurementFeed([rows], scene(), config)
        found = list(feed.joined(iter(()), sensors=frozenset("abr") - {without}))
        assert [v for s in found for v in s.measured.distances.value.tolist()] == left, without


def test_times_that_go_back_are_refused() -> None:
    parts = [table(sensor=["a"], t_ns=[5], range=[1.0]), table(sensor=["a"], t_ns=[4], range=[1.0])]
    with pytest.raises(InputError, match=r"time 0.000000004 s is earlier than the preceding 0.000000005 s"):
        list(DistanceMeasurementFeed(parts, scene(), DistanceMeasurementConfig(sigma_range=1.0)).joined(iter(())))


def test_reads_with_a_strength_are_measurements() -> None:
    reads = Reads.of(t_ns=[0, 1], sensor=["r", "r"], tag=["x", "x"], target_id=[3, 3], rssi=[-60.0, np.nan])
    (found,) = measurements_of_reads([reads])
    assert found.rssi.tolist() == [-60.0]
    assert found.target_id.tolist() == [3]
