"""Bearings that are clockwise from north are noticed, and no others are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from occlog.cli.main import run
from occlog.consistency.bearings import MIN_STEPS, AngleConventionCheck, misfit
from occlog.errors import ExitCode
from occlog.records.scene import MicrophoneArray, Scene
from occlog.records.tables import Bearings
from occlog.records.verdicts import findings

PLACES = np.array([[0.0, 0.0], [100.0, 10.0], [30.0, 80.0]])
NAMES = ["a", "b", "c"]
SCENE = Scene(arrays=tuple(MicrophoneArray(n, np.append(p, 0.0)) for n, p in zip(NAMES, PLACES, strict=True)))


def table(n: int, *, compass: bool, sigma: float, false: float = 0.0) -> Bearings:
    rng = np.random.default_rng(3)
    away = rng.uniform([10, 10], [90, 70], (n, 1, 2)) - PLACES
    angle = np.arctan2(away[..., 1], away[..., 0]) + sigma * rng.standard_normal((n, 3))
    angle = np.where(rng.random(angle.shape) < false, rng.uniform(-3, 3, angle.shape), angle)
    value = np.mod((0.5 * np.pi - angle if compass else angle) + np.pi, 2 * np.pi) - np.pi
    blank = np.full(3 * n, np.nan)
    return Bearings.of(
        t_ns=np.repeat(np.arange(n), 3),
        sensor=np.tile(NAMES, n),
        target_id=np.zeros(3 * n, dtype=np.int32),
        seen=np.ones(3 * n, dtype=np.bool_),
        bearing=value.ravel(),
        sigma=np.full(3 * n, sigma),
        u_px=blank,
        sigma_px=blank,
        score=blank,
    )


def codes(rows: Bearings) -> list[str]:
    compass = AngleConventionCheck(SCENE)
    assert sum(map(len, compass.watch([rows]))) == len(rows)
    return [f.id for f in findings(compass.checks())]


@pytest.mark.parametrize(("sigma", "false"), [(0.01, 0.0), (0.1, 0.0), (0.02, 0.05)])
def test_bearings_of_a_compass_are_noticed_and_plain_ones_pass(sigma: float, false: float) -> None:
    assert codes(table(40, compass=True, sigma=sigma, false=false)) == ["compass"]
    assert codes(table(40, compass=False, sigma=sigma, false=false)) == []


YAWS = np.radians([50.0, 160.0, -70.0])


def turned_scene(yaw: np.ndarray, order: list[int]) -> Scene:
    """Arrays with yaws (3,), at the positions of the order."""
    arrays = zip(NAMES, PLACES[order], yaw[order].tolist(), strict=True)
    return Scene(arrays=tuple(MicrophoneArray(name, np.append(p, 0.0), yaw=y) for name, p, y in arrays))


def misread(true: np.ndarray, how: str) -> tuple[np.ndarray, Scene]:
    """Bearings (n, 3) in the world as they are read with a mistake, and the scene."""
    in_array = (true - YAWS + np.pi) % (2.0 * np.pi) - np.pi
    right, order = turned_scene(YAWS, [0, 1, 2]), [0, 1, 2]
    if how == "negate":
        return -true, right
    if how == "relative":
        return in_array, right
    if how == "world":
        return true + YAWS, right
    if how == "in the arrays":
        return YAWS - in_array, right
    if how == "yaw in radians":
        stated = np.radians(YAWS)
        return in_array + stated, turned_scene(stated, order)
    if how == "exchanged":
        return true, turned_scene(YAWS, [1, 0, 2])
    if how in ("are in turns", "are in gon"):
        return np.mod(true, 2.0 * np.pi) / (360.0 if how == "are in turns" else 0.9), right
    if how in ("are in radians", "are in radians in the arrays"):
        return np.radians(in_array) + YAWS if how.endswith("arrays") else np.radians(true), right
    if how == "b are in gon":
        return np.column_stack([true[:, 0], np.mod(true[:, 1], 2.0 * np.pi) / 0.9, true[:, 2]]), right
    if how == "b are in radians":
        return np.column_stack([true[:, 0], np.radians(true[:, 1]), true[:, 2]]), right
    assert how == "c are turned by 180"
    return true + np.array([0.0, 0.0, np.pi]), right


@pytest.mark.parametrize(
    "how",
    [
        "negate",
        "relative",
        "world",
        "in the arrays",
        "yaw in radians",
        "exchanged",
        "are in turns",
        "are in gon",
        "are in radians",
        "are in radians in the arrays",
        "b are in gon",
        "b are in radians",
        "c are turned by 180",
    ],
)
def test_other_readings_of_bearings_are_named(how: str) -> None:
    rows = table(40, compass=False, sigma=0.01)
    bearing, scene = misread(rows.bearing.reshape(-1, 3), how)
    check = AngleConventionCheck(scene)
    wrapped = (bearing.ravel() + np.pi) % (2.0 * np.pi) - np.pi
    list(check.watch([replace(rows, bearing=wrapped)]))
    (found,) = findings(check.checks())
    assert found.id == "bearings-fit-if"
    assert how in found.text


def test_few_moments_and_bearings_that_fit_nothing_say_nothing() -> None:
    assert codes(table(MIN_STEPS - 1, compass=True, sigma=0.01)) == []
    assert codes(table(40, compass=True, sigma=0.01, false=1.0)) == []


def test_lines_that_meet_have_no_misfit_and_lines_that_meet_behind_have_the_most() -> None:
    away = np.array([40.0, 40.0]) - PLACES
    angle = np.arctan2(away[:, 1], away[:, 0])
    assert misfit(PLACES, angle) == pytest.approx(0.0, abs=1e-20)
    assert misfit(PLACES, angle + np.pi) == pytest.approx(1.0)


@pytest.mark.jit
@pytest.mark.parametrize(("column", "reported"), [("bearing_deg", True), ("compass_deg", False)])
def test_a_log_of_a_compass_is_tracked_by_its_column_and_warned_of_without(tmp_path, capsys, column, reported) -> None:
    rows = table(15, compass=True, sigma=0.01)
    lines = [f"{t},{s},{np.degrees(b):.4f},0.6,0" for t, s, b in zip(rows.t_ns, rows.sensor, rows.bearing, strict=True)]
    (tmp_path / "b.csv").write_text("\n".join([f"time,station,{column},sigma_deg,id", *lines]) + "\n")
    places = [f"{n},{x},{y}" for n, (x, y) in zip(NAMES, PLACES.tolist(), strict=True)]
    (tmp_path / "s.csv").write_text("\n".join(["name,x,y", *places]) + "\n")
    out = ["--method", "fix", "-o", str(tmp_path / "t.parquet"), "--json"]
    assert run(["track", str(tmp_path / "b.csv"), "--scene", str(tmp_path / "s.csv"), *out]) == ExitCode.DONE
    captured = capsys.readouterr()
    assert ("clockwise from north (compass)" in captured.err) is reported
    assert ('"plausible": true' in captured.out) is not reported


def test_an_array_that_is_turned_is_not_one_in_gon_and_far_targets_are_not_in_radians() -> None:
    rows = table(40, compass=False, sigma=0.01)
    bearing = rows.bearing.reshape(-1, 3) + np.radians([0.0, 15.0, 0.0])
    wrapped = (bearing.ravel() + np.pi) % (2.0 * np.pi) - np.pi
    assert codes(replace(rows, bearing=wrapped)) == []
    rng = np.random.default_rng(5)
    away = np.array([3000.0, 40.0]) + rng.uniform(-100, 100, (40, 1, 2)) - PLACES
    far = np.arctan2(away[..., 1], away[..., 0])
    assert codes(replace(rows, bearing=far.ravel())) == []


def wrapped(bearing: np.ndarray) -> np.ndarray:
    return (bearing.ravel() + np.pi) % (2.0 * np.pi) - np.pi


@pytest.mark.parametrize("turn", [12.0, 20.0, -100.0])
def test_all_arrays_that_are_turned_by_one_angle_are_named_with_it(turn: float) -> None:
    rows = table(60, compass=False, sigma=0.01)
    check = AngleConventionCheck(SCENE)
    list(check.watch([replace(rows, bearing=wrapped(rows.bearing + np.radians(turn)))]))
    (found,) = findings(check.checks())
    assert found.id == "bearings-fit-if"
    off = float(found.text.split("turned by ")[1].split()[0])
    assert abs(off - turn) < 0.5


def test_one_array_that_is_turned_for_a_target_that_stands_is_not_all_turned() -> None:
    rows = table(60, compass=False, sigma=0.01)
    away = np.array([40.0, 35.0]) - PLACES
    still = np.arctan2(away[:, 1], away[:, 0]) + 0.01 * np.random.default_rng(4).standard_normal((60, 3))
    for name in range(3):
        turned = still + np.radians(12.0) * (np.arange(3) == name)
        assert codes(replace(rows, bearing=wrapped(turned))) == []


@pytest.mark.parametrize("name", ["a", "b"])
def test_two_stations_list_the_readings_that_fit_as_well(name: str) -> None:
    rows = table(60, compass=False, sigma=0.005)
    rows = rows.take(rows.sensor != "c")
    assert codes(rows) == []
    check = AngleConventionCheck(SCENE)
    turned = rows.bearing + np.pi * (rows.sensor == name)
    list(check.watch([replace(rows, bearing=wrapped(turned))]))
    (found,) = findings(check.checks())
    assert found.id == "bearings-fit-if"
    assert f"those of {name} are turned by 180 degrees" in found.text
