"""One simulated recording before and after the fusion of detections, as figures; described by plain values."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from ..core.metrics import ratio
from ..io.scene_file import scene_from_yaml
from ..records import Bearings, Tracks, Truth, Views
from ..scene import Scene
from ..stages.detect_config import Detections
from ..stages.evaluate_config import EvaluateConfig
from ..stages.evaluate_detection import Counts, add_counts, count, looks_of
from ..stages.fuse import fuse
from ..stages.fuse_config import FuseConfig
from ..stages.fuse_input import only_measured
from ..stages.simulate import ObserveConfig, WorldConfig, observe, simulate_truth, world_config
from ..stages.track import choose_sensors, track
from ..sweep.trial import errors_of
from ..trackers import tracker
from ..trackers.settings import configure

DIAMETER = 3.33
"""Of everybody in the room, in units."""
START = 10
"""Estimates left out at the start of a track."""


def fusion_trial(spec: Mapping[str, Any]) -> dict[str, float]:
    """Figures of a trial.

    Args:
        spec: `scene` (YAML text), `seed`, `run`, `steps`, `occluders`, `cameras` (names), `miss`, `false` (of every
            camera; the fusion is told both), `fuse` (fields of `FuseConfig`) and `track` (also track what came out).

    Returns:
        For `before` and `after` the fusion: `detection_` rate of visible targets, `false_` reports a frame, `hidden_`
        reports of targets behind others, as a share of them; `nees_recovered`, the mean squared error of recovered
        bearings in their variances; and of the tracks `rmse_raw`, `rmse_ignore`, `rmse_use`.
    """
    scene = scene_from_yaml(spec["scene"], "scene")
    seed = int(np.random.SeedSequence(int(spec["seed"]), spawn_key=(int(spec["run"]),)).generate_state(1, np.uint32)[0])
    world = {"steps": int(spec["steps"]), "occluders": int(spec["occluders"]), "diameter": DIAMETER}
    config: WorldConfig = configure(world_config(scene.length_unit), world, "simulate")
    truth = Truth.concat(list(simulate_truth(scene, config, seed)))
    looks = ObserveConfig(diameter=DIAMETER, miss=float(spec["miss"]), false_alarm=float(spec["false"]))
    raw = Bearings.concat(list(observe(scene, [truth], looks, seed)))
    raw = raw.take(np.isin(raw.sensor, list(spec["cameras"])))
    options: dict[str, Any] = {"p_miss": float(spec["miss"]), "p_false": float(spec["false"])}
    options |= dict(spec.get("fuse", {}))
    parts = fuse([Detections(Views.empty(), raw, (), 0, 0)], scene, FuseConfig(**options))
    fused = Bearings.concat([p.bearings for p in parts])
    figures = _rates(_counts(raw, truth, scene), "before") | _rates(_counts(fused, truth, scene), "after")
    recovered = _counts(fused.take(fused.cause == "recovered"), truth, scene)
    figures["nees_recovered"] = ratio(recovered.square_normalised, recovered.detected)
    if spec.get("track"):
        inputs = {"raw": [raw], "ignore": only_measured([fused]), "use": [fused]}
        figures |= {f"rmse_{name}": _rmse(rows, truth, scene, seed) for name, rows in inputs.items()}
    return figures


def _counts(bearings: Bearings, truth: Truth, scene: Scene) -> Counts:
    config = EvaluateConfig(occluder_diameter=DIAMETER)
    return add_counts(count(c) for c in looks_of(bearings, truth, scene, {0: 0}, config).values())


def _rates(c: Counts, when: str) -> dict[str, float]:
    hidden = c.looks - c.visible
    return {
        f"detection_{when}": ratio(c.detected, c.visible),
        f"false_{when}": ratio(c.false_alarms, c.frames),
        f"hidden_{when}": ratio(c.detected_hidden, hidden),
    }


def _rmse(rows: Iterable[Bearings], truth: Truth, scene: Scene, seed: int) -> float:
    """Of the auxiliary particle filter with its defaults."""
    config = tracker("apf").defaults(scene.length_unit)
    parts = track(rows, scene, config, seed, method="apf", sensors=choose_sensors(scene, ()))
    tracks = Tracks.concat([p.tracks for p in parts])
    return errors_of(tracks, truth, scene, START)["rmse"]
