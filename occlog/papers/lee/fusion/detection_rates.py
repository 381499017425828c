"""[Lee] Ch. 4 on simulated cameras: detection and false rates before and after the fusion, and a tracker's gain."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from occlog.core.metrics.errors import ratio_or_nan
from occlog.evaluate.bearings.detections import DetectionCounts, add_counts, count, observations_of
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.io.formats.scenes.scene import scene_from_yaml
from occlog.measure.detections import Detections
from occlog.measure.fuse.config import FuseConfig
from occlog.measure.fuse.stage import fuse
from occlog.papers import verdicts as v
from occlog.papers.ercan.trial import SQUARE_ORDER, names, square_room
from occlog.papers.verdicts import Execute, Experiment, PaperRow, Size, StatementVerdict, Table
from occlog.pipeline.sweep.trial import Spec, errors_of
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Tracks, Truth, Views
from occlog.scans.grouping import choose_sensors
from occlog.scans.sources import only_measured
from occlog.settings import configure
from occlog.simulate.config import ObserveConfig, WorldConfig
from occlog.simulate.sensors.cameras import observe
from occlog.simulate.stage import simulate_truth
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.methods.apf.config import ApfConfig

DIAMETER = 3.33
"""Diameter of all people in the room, in units of the scene."""
START = 10
"""Estimates skipped at the start of a track."""


def fusion_trial(spec: Spec) -> dict[str, float]:
    """Run a trial: rates of detections of one simulated recording before and after their fusion.

    Args:
        spec: `scene` (YAML text), `seed`, `run`, `steps`, `occluders`, `cameras` (names), `miss` and `false` (of
            every camera; the fusion assumes both), `fuse` (fields of `FuseConfig`) and `track` (true: also track).

    Returns:
        For `before` and `after` the fusion: `detection_` rate of visible targets, `false_` alarms per frame,
        `hidden_` detections of targets behind others, as a share of them; `nees_recovered`, the mean squared error
        of recovered bearings over their variances; and RMSE of tracks of unfused bearings (`rmse_raw`), and of
        fused ones with recovered rows ignored or used (`rmse_ignore`, `rmse_use`).
    """
    scene = scene_from_yaml(spec["scene"], "scene")
    seed = int(np.random.SeedSequence(int(spec["seed"]), spawn_key=(int(spec["run"]),)).generate_state(1, np.uint32)[0])
    world = {"steps": int(spec["steps"]), "occluders": int(spec["occluders"]), "diameter": DIAMETER}
    config: WorldConfig = configure(WorldConfig.in_unit(scene.length_unit), world)
    truth = Truth.concat(list(simulate_truth(scene, config, seed)))
    observation = ObserveConfig(
        diameter=DIAMETER, miss_probability=float(spec["miss"]), false_alarm_probability=float(spec["false"])
    )
    raw = Bearings.concat(list(observe(scene, [truth], observation, seed)))
    raw = raw.take(np.isin(raw.sensor, list(spec["cameras"])))
    options: dict[str, object] = {
        "miss_probability": float(spec["miss"]),
        "false_alarm_probability": float(spec["false"]),
    }
    options |= dict(spec.get("fuse", {}))
    parts = fuse(
        [Detections(views=Views.empty(), bearings=raw, losses=(), frames=0, warmup=0)],
        scene,
        configure(FuseConfig.in_unit(scene.length_unit), options),
    )
    fused = Bearings.concat([p.bearings for p in parts])
    figures = _rates(_counts(raw, truth, scene), "before") | _rates(_counts(fused, truth, scene), "after")
    recovered = _counts(fused.take(fused.cause == "recovered"), truth, scene)
    figures["nees_recovered"] = ratio_or_nan(recovered.square_normalised, recovered.detected)
    if spec.get("track"):
        inputs = {"raw": [raw], "ignore": only_measured([fused]), "use": [fused]}
        figures |= {f"rmse_{name}": _rmse(rows, truth, scene, seed) for name, rows in inputs.items()}
    return figures


def _counts(bearings: Bearings, truth: Truth, scene: Scene) -> DetectionCounts:
    config = EvaluateConfig(occluder_diameter=DIAMETER)
    return add_counts(count(c) for c in observations_of(bearings, truth, scene, {0: 0}, config).values())


def _rates(c: DetectionCounts, when: str) -> dict[str, float]:
    hidden = c.n_frames - c.visible
    return {
        f"detection_{when}": ratio_or_nan(c.detected, c.visible),
        f"false_{when}": ratio_or_nan(c.false_alarms, c.frames),
        f"hidden_{when}": ratio_or_nan(c.detected_hidden, hidden),
    }


def _rmse(rows: Iterable[Bearings], truth: Truth, scene: Scene, seed: int) -> float:
    """Track the rows with the defaults of the auxiliary particle filter; return the RMSE after `START` estimates."""
    config = ApfConfig.in_unit(scene.length_unit)
    parts = track(rows, scene, TrackingTask(config, seed, sensors=choose_sensors(scene, ())))
    tracks = Tracks.concat([p.tracks for p in parts])
    return errors_of(tracks, truth, scene, START)["rmse"]


MISS = 0.2
"""Probability that a camera misses a visible target."""
FALSE = (0.05, 0.1, 0.2)
"""Probabilities of a false report of a camera in a frame."""
CAMERAS = (3, 4, 8)
"""Numbers of cameras."""
DETECTED, REPORTED = "detected", "false"
RATES = {"detection": DETECTED, "false": REPORTED}
RAW, IGNORE, USE = "not fused", "fused", "fused, all used"
TRACKED = {"rmse_raw": RAW, "rmse_ignore": IGNORE, "rmse_use": USE}
NOTE = f"Reference room of 100 x 100; series: number of cameras, each of which misses {MISS:.0%} of what it could see."


def rates(size: Size, execute: Execute) -> Table:
    """Table of detection and false alarm rates, before and after fusion, against the probability of a false report."""
    rows = []
    for (n, x), own in _done(size, execute, track=False):
        extra = {key: math.fsum(r[key] for r in own) / size.runs for key in ("hidden_before", "hidden_after")}
        extra["nees_recovered"] = math.fsum(r["nees_recovered"] for r in own) / size.runs
        for key, what in RATES.items():
            for when in ("before", "after"):
                rows.append(PaperRow(f"{n}, {what}, {when}", x, tuple(r[f"{key}_{when}"] for r in own), extra))
    return rows


def errors(size: Size, execute: Execute) -> Table:
    """Table of the RMSE of the auxiliary particle filter against the false alarm probability."""
    return [
        PaperRow(f"{n}, {what}", x, tuple(r[key] for r in own))
        for (n, x), own in _done(size, execute, track=True)
        for key, what in TRACKED.items()
    ]


def _done(size: Size, execute: Execute, *, track: bool) -> list[tuple[tuple[int, float], list[dict[str, float]]]]:
    """Run all trials; return number of cameras, false alarm probability, and the figures of each run.

    `track`: the trials also track.
    """
    cameras = CAMERAS[1:2] if size.quick else CAMERAS
    points = [(n, x) for n in cameras for x in (FALSE[::2] if size.quick else FALSE)]
    return v.run_trials(points, size, execute, lambda p, run: _spec(size, run, *p, track))


def _spec(size: Size, run: int, cameras: int, false: float, track: bool) -> Spec:
    return {
        "kind": "lee-fusion",
        "scene": square_room(pillar=True),
        "seed": size.seed,
        "run": run,
        "steps": size.steps,
        "occluders": 0,
        "cameras": names(SQUARE_ORDER[:cameras]),
        "miss": MISS,
        "false": false,
        "track": track,
    }


def judge_rates(table: Table) -> list[StatementVerdict]:
    """Verdicts on [Lee] Sec. 4.1: fusion recovers missed detections, and false ones do not spread to other cameras."""
    missed = "Missed detections are recovered: detection rate higher by this"
    false = "False detections do not spread: fewer false reports a frame, by this"
    return [
        *_judged(table, "detection", statement=missed, low=f"{DETECTED}, before", high=f"{DETECTED}, after"),
        *_judged(table, "false", statement=false, low=f"{REPORTED}, after", high=f"{REPORTED}, before"),
    ]


def judge_errors(table: Table) -> list[StatementVerdict]:
    """Verdicts on whether a tracker gains by fused bearings, and loses if it counts recovered ones as measured."""
    gains = "A filter gains by the fusion, recovered rows as not seen (of this project): RMSE lower by this"
    twice = "Recovered rows as measured count the same twice (of this project): RMSE higher by this"
    return [
        *_judged(table, "fused", statement=gains, low=IGNORE, high=RAW),
        *_judged(table, "twice", statement=twice, low=IGNORE, high=USE),
    ]


def _judged(table: Table, key: str, statement: str, low: str, high: str) -> list[StatementVerdict]:
    """Verdicts on whether one series is below another, for each number of cameras.

    Args:
        table: table of the experiment.
        key: begins the ids.
        statement: text of the statement.
        low: name of the lower series.
        high: name of the higher series.
    """
    found = [(n, v.matched(table, f"{n}, {low}", f"{n}, {high}")) for n in CAMERAS]
    return [v.pairs(f"{key}-{n}", f"{statement}; {n} cameras.", points) for n, points in found if points]


FUSION_EXPERIMENTS = (
    Experiment(
        item="detection",
        title="Detections before and after the fusion",
        x_label="probability of a false report",
        y_label="rate",
        runs=12,
        steps=400,
        quick=(2, 60),
        compute=rates,
        judge=judge_rates,
        trial=fusion_trial,
        note=f"{NOTE} Detected: share of the observations of a visible target; false: a frame.",
    ),
    Experiment(
        item="fused-track",
        title="A particle filter on fused bearings",
        x_label="probability of a false report",
        y_label="RMSE",
        runs=6,
        steps=300,
        quick=(2, 60),
        compute=errors,
        judge=judge_errors,
        trial=fusion_trial,
        note=f"{NOTE} Recovered rows are taken as not seen, or (all used) as measured.",
    ),
)
