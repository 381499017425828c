"""What simulated stations measure of distances: exact values, shares of false and missing ones, detours."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from occlog.array_types import NS
from occlog.cli.main import run
from occlog.core.numerics.interpolate import TimeGrid
from occlog.errors import ExitCode
from occlog.io.open import open_input
from occlog.records.declared.sensors import Measurements
from occlog.records.scene import MicrophoneArray, Scene
from occlog.records.tables import Truth
from occlog.simulate.config import MeasureConfig, ReadConfig
from occlog.simulate.sensors.stations import observe_stations

ROOM = np.array([[0.0, 0.0], [12.0, 0.0], [12.0, 9.0], [0.0, 9.0]])
PLACES = np.array([[0.0, 0.0, 3.0], [12.0, 0.0, 3.0]])
SCENE = Scene(arrays=tuple(MicrophoneArray(f"s{n}", place) for n, place in enumerate(PLACES)), room=ROOM)
QUIET = ReadConfig(noise_db=0.0, shadow_db=0.0)
STEPS = 4000


def grid(steps: int = STEPS) -> TimeGrid:
    """Target 3 stays at (4, 0, 0): 5 and 8.54 m from the stations in space; 20 is an occluder."""
    xyz = np.tile([[[4.0, 0.0, 0.0], [1.0, 1.0, 0.0]]], (steps, 1, 1))
    t_ns = np.arange(steps) * NS
    return TimeGrid(t_ns, np.array([3, 20]), np.array([True, False]), xyz)


def measured(radio: ReadConfig = QUIET, chunks: tuple[TimeGrid, ...] | None = None, **how: object) -> Measurements:
    config = MeasureConfig(**how)  # type: ignore[arg-type]
    return Measurements.concat(observe_stations(SCENE, chunks or (grid(),), config, radio, seed=4))


def test_values_are_of_distances_in_space_with_the_stated_noise() -> None:
    found = measured(measure="range, difference,strength", range_noise=0.2, range_difference_noise=0.3)
    assert set(found.target_id.tolist()) == {3}
    first, second = (found.take(found.sensor == name) for name in ("s0", "s1"))
    assert set(first.reference.tolist()) == {""}
    assert set(second.reference.tolist()) == {"s0"}
    far = np.array([5.0, np.hypot(8.0, 3.0)])
    for rows, distance in ((first, far[0]), (second, far[1])):
        error = rows.range - distance
        assert abs(error.mean()) < 4 * 0.2 / STEPS**0.5
        assert error.std() == pytest.approx(0.2, rel=4 / (2 * STEPS) ** 0.5)
        np.testing.assert_allclose(rows.rssi, -60.0 - 20.0 * np.log10(distance))
    error = second.range_difference - (far[1] - far[0])
    assert abs(error.mean()) < 4 * 0.3 / STEPS**0.5
    assert error.std() == pytest.approx(0.3, rel=4 / (2 * STEPS) ** 0.5)
    assert set(second.sigma_range_difference.tolist()) == {0.3}


def test_shares_of_missing_and_false_values_are_as_stated() -> None:
    found = measured(measure="range", measure_miss_probability=0.25, measure_outlier_probability=0.2, range_noise=1e-6)
    rows = found.take(found.sensor == "s0")
    assert abs(len(rows) / STEPS - 0.75) < 4 * (0.25 * 0.75 / STEPS) ** 0.5
    false = np.abs(rows.range - 5.0) > 1e-3
    assert abs(false.mean() - 0.2) < 4 * (0.2 * 0.8 / len(rows)) ** 0.5
    # Uniform up to the diagonal of the room, 15 m
    assert rows.range[false].max() <= 15.0
    assert abs(rows.range[false].mean() - 7.5) < 4 * 15.0 / 12**0.5 / false.sum() ** 0.5


def test_detours_are_exponential_and_make_ranges_longer_only() -> None:
    found = measured(measure="range", nlos_probability=0.5, nlos_bias=2.0, range_noise=1e-6)
    longer = found.range[found.sensor == "s1"] - np.hypot(8.0, 3.0)
    assert longer.min() > -1e-4
    late = longer[longer > 1e-3]
    assert abs(len(late) / STEPS - 0.5) < 0.04
    assert late.mean() == pytest.approx(2.0, rel=4 / len(late) ** 0.5)
    assert late.std() == pytest.approx(2.0, rel=0.15)


def test_a_kind_more_and_chunks_change_nothing_of_the_others() -> None:
    alone = measured(measure="range")
    among = measured(measure="range,difference,strength")
    np.testing.assert_array_equal(alone.range, among.range)
    whole, radio = grid(60), ReadConfig()
    parts = tuple(whole._replace(t_ns=whole.t_ns[a : a + 20], xyz=whole.xyz[a : a + 20]) for a in (0, 20, 40))
    one = measured(radio, (whole,), measure="strength", measure_rate_hz=0.5)
    cut = measured(radio, parts, measure="strength", measure_rate_hz=0.5)
    assert len(one) == 2 * 30
    assert np.unique(cut.t_ns).tolist() == np.unique(one.t_ns).tolist()


def test_shadowing_lasts() -> None:
    found = measured(ReadConfig(noise_db=0.0, shadow_db=4.0, shadow_s=10.0), measure="strength")
    shadow = found.rssi[found.sensor == "s0"] + 60.0 + 20.0 * np.log10(5.0)
    assert np.corrcoef(shadow[:-1], shadow[1:])[0, 1] == pytest.approx(np.exp(-0.1), abs=0.03)
    assert shadow.std() == pytest.approx(4.0, rel=0.25)


SCENE_FILE = """occlog_scene: 1
length_unit: m
room: [[0, 0], [12, 0], [12, 9], [0, 9]]
microphone_arrays:
  - {name: s0, position: [0, 0]}
  - {name: s1, position: [12, 0]}
  - {name: s2, position: [6, 9]}
"""


def test_from_the_command_to_a_track_and_its_bound(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "s.yaml").write_text(SCENE_FILE)
    made, table, tracks = (str(tmp_path / name) for name in ("m.mcap", "m.csv", "t.parquet"))
    args = [
        "simulate",
        str(tmp_path / "s.yaml"),
        "-o",
        made,
        "--seconds",
        "6",
        "--object-height",
        "0",
        "--measure",
        "range",
    ]
    assert run([*args, "--measure-rate", "5"]) == ExitCode.DONE
    assert "measurements: 93" in capsys.readouterr().out  # 31 times, three stations
    truth = open_input(Path(made)).read(Truth)
    assert len(truth) == 61
    assert run(["export", made, "--table", "measurements", "-o", table]) == ExitCode.DONE
    assert run(["track", table, "--scene", str(tmp_path / "s.yaml"), "--method", "fix", "-o", tracks]) == ExitCode.DONE
    bound = ["evaluate", tracks, "--truth", made, "--measurements", made, "--fail-if", "rmse_m>0.5"]
    assert run([*bound, "--fail-if", "bound_rmse_m>0.2"]) == ExitCode.DONE


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["--measure", "ranges"], "one or several of range, difference, strength"),
        (
            ["--measure-miss-probability", "0.1"],
            "--measure-miss-probability applies to measurements of distances; add --measure",
        ),
        (["--measure", "range", "--measure-outlier-probability", "1.5"], "1.5"),
        (
            ["--measure", "range", "--read-noise", "3"],
            "--read-noise applies to readers of tags, but the scene has none",
        ),
    ],
)
def test_what_does_not_go_together_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], args: list[str], message: str
) -> None:
    (tmp_path / "s.yaml").write_text(SCENE_FILE)
    made = tmp_path / "m.mcap"
    assert run(["simulate", str(tmp_path / "s.yaml"), "-o", str(made), *args]) == ExitCode.USAGE
    assert message in capsys.readouterr().err
    assert not made.exists()
