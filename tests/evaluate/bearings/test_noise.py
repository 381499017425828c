"""Noise of bearings, learned from how far lines of sight miss one another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from occlog.evaluate.bearings.noise import MIN_SCANS, NoiseFigures, ScanCuts, labelled, noise_scale
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.matching.paths import sensors_of
from occlog.records.scene import Camera, Scene, camera_rotation
from occlog.records.tables import LAST, Bearings

SECOND = 1_000_000_000
STATED = 0.01


def scene(n: int) -> Scene:
    around = 2.0 * np.pi * np.arange(n) / n
    return Scene(
        cameras=tuple(
            Camera(
                f"c{i}",
                np.array([10.0 * np.cos(a), 10.0 * np.sin(a), 0.0]),
                camera_rotation(a + np.pi, 0.0, 0.0),
                np.full(2, 500.0),
                np.zeros(2),
            )
            for i, a in enumerate(around)
        )
    )


def bearings(made_scene: Scene, scans: int, scale: float, false: float = 0.0, seed: int = 1) -> Bearings:
    """Of a target that stands about anywhere within 4 m of the middle; noise is `scale` times what is stated."""
    rng = np.random.default_rng(seed)
    xy, n = rng.uniform(-3.0, 3.0, (scans, 2)), len(made_scene.cameras)
    away = xy[:, None] - np.array([c.ground for c in made_scene.cameras])
    angle = np.arctan2(away[..., 1], away[..., 0]) + scale * STATED * rng.standard_normal((scans, n))
    angle = np.where(rng.random((scans, n)) < false, angle + rng.uniform(-0.7, 0.7, (scans, n)), angle)
    angle = (angle.ravel() + np.pi) % (2.0 * np.pi) - np.pi
    return Bearings.of(
        t_ns=np.repeat(SECOND * np.arange(scans), n),
        sensor=np.tile([c.name for c in made_scene.cameras], scans),
        target_id=np.zeros(scans * n, dtype=np.int32),
        seen=np.ones(scans * n, dtype=bool),
        bearing=angle,
        sigma=np.full(scans * n, STATED),
        u_px=np.zeros(scans * n),
        sigma_px=np.full(scans * n, 5.0),
        score=np.full(scans * n, np.nan),
    )


def noise_metrics(rows: Bearings, made_scene: Scene, config: EvaluateConfig) -> dict[str, float]:
    found, own = NoiseFigures(config), labelled(rows, config)
    found.see(own)
    for scans in ScanCuts(config).update(own, LAST):
        found.update(scans, sensors_of(made_scene, set(own.sensor.tolist())))
    return found.result()


@pytest.mark.jit
@pytest.mark.parametrize("scale", [0.3, 1.0, 2.5])
@pytest.mark.parametrize("sensors", [3, 5])
def test_the_factor_is_found_with_and_without_false_bearings(scale: float, sensors: int) -> None:
    made_scene = scene(sensors)
    for false in (0.0, 0.05, 0.2):
        found = noise_metrics(bearings(made_scene, 600, scale, false), made_scene, EvaluateConfig())
        assert found["measurement_noise_scale"] == pytest.approx(scale, rel=0.1)
        assert found["measurement_noise_px"] == pytest.approx(5.0 * found["measurement_noise_scale"])
        assert found["measurement_noise_scans"] == 600


def test_two_sensors_tell_nothing_and_neither_do_few_scans_or_other_targets_lines() -> None:
    two, three = scene(2), scene(3)
    assert noise_metrics(bearings(two, 50, 1.0), two, EvaluateConfig()) == {}
    rows = bearings(three, MIN_SCANS, 1.0)
    assert np.isfinite(noise_metrics(rows, three, EvaluateConfig())["measurement_noise_scale"])
    fewer = rows.take(slice(3, None))
    assert np.isnan(noise_metrics(fewer, three, EvaluateConfig())["measurement_noise_scale"])
    candidates = replace(rows, target_id=np.full(len(rows), -1, dtype=np.int32))
    assert noise_metrics(candidates, three, EvaluateConfig()) == {}
    held_out = replace(EvaluateConfig(), held_out=("c1",))
    assert noise_metrics(rows, three, held_out) == {}


def test_exact_lines_need_no_noise() -> None:
    assert noise_scale(np.zeros(30), np.ones(30, dtype=np.int64)) == 0.0
