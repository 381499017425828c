"""[Ercan] Sec. 4.4: where the other objects are, by their own filters or by one of all objects together.

Bearings of all objects are given, labelled.  `joint` tracks the target and the others in one state; `apf` tracks each
alone, and then the target once more with the Gaussians of the others' filters as priors of the occluders.
"""

from __future__ import annotations

import time
from collections.abc import Mapping

import numpy as np

from occlog.io.formats.scenes.scene import scene_from_yaml
from occlog.papers import verdicts as v
from occlog.papers.verdicts import Execute, Experiment, PaperRow, Size, StatementVerdict, Table, power_of, quotient_of
from occlog.pipeline.sweep.trial import Spec, errors_of
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Diagnostics, Occluders, Tracks, Truth
from occlog.settings import Settings
from occlog.simulate.config import ObserveConfig, WorldConfig
from occlog.simulate.sensors.cameras import observe
from occlog.simulate.stage import simulate_truth
from occlog.track.drivers.rows import TrackChunk
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.methods.apf.config import ApfConfig
from occlog.track.methods.joint.config import JointConfig

from .trial import SQUARE_ORDER, names, square_room

JOINT, SEPARATE, NONE = "joint", "a filter for each object, then priors", "no priors"
CAMERAS = 4
SKIP = 10
"""Estimates skipped at the start."""
LEFT, SOME = 10.0, 3.0
"""Factors by which effective particles fall that count as prohibitive, and as that in part."""


def figures_of(spec: Spec) -> dict[str, float]:
    """Track one target by all three ways, in one simulated world with `spec["others"]` other objects.

    Args:
        spec: `scene` (YAML text), `seed`, `steps`, `particles` and `others`.

    Returns:
        For each way `<way>, rmse`, `<way>, ess` (mean effective particles of the target) and `<way>, seconds` (CPU;
        of both passes for the way that has two).
    """
    scene = scene_from_yaml(spec["scene"], "scene")
    seed, targets = int(spec["seed"]), 1 + int(spec["others"])
    world = WorldConfig(steps=int(spec["steps"]), targets=targets, occluders=0)
    truth = Truth.concat(list(simulate_truth(scene, world, seed)))
    bearings = Bearings.concat(list(observe(scene, [truth], ObserveConfig(diameter=world.diameter), seed)))
    L, out = int(spec["particles"]), {}

    def add(name: str, parts: list[TrackChunk], seconds: float) -> None:
        tracks, notes = Tracks.concat([p.tracks for p in parts]), Diagnostics.concat([p.diagnostics for p in parts])
        out[f"{name}, rmse"] = errors_of(tracks, truth, scene, SKIP)["rmse"]
        out[f"{name}, ess"] = float(notes.ess[notes.target_id == 0].mean())
        out[f"{name}, seconds"] = seconds

    parts, joint = _tracked(scene, bearings, JointConfig(particles=L), seed, "joint")
    add(JOINT, parts, joint)
    parts, alone = _tracked(scene, bearings, ApfConfig(particles=L), seed, "apf")
    add(NONE, parts, alone)
    others = Tracks.concat([p.tracks for p in parts])
    others = others.take(others.target_id > 0)
    more = ApfConfig(particles=L, occlusion_tempering=1.0)
    parts, again = _tracked(scene, bearings, more, seed, "apf", (0,), priors_of(others))
    add(SEPARATE, parts, alone + again)
    return out


def _tracked(
    scene: Scene,
    bearings: Bearings,
    config: Settings,
    seed: int,
    method: str,
    targets: tuple[int, ...] | None = None,
    priors: Occluders | None = None,
) -> tuple[list[TrackChunk], float]:
    """Track with one method; return the chunks of tracks, and the CPU time [s].

    Args:
        scene: scene.
        bearings: bearings of all its sensors, of which those of the first `CAMERAS` cameras are used.
        config: settings of the method.
        seed: seed of its random numbers.
        method: name of the method.
        targets: labels that are tracked; None: all.
        priors: priors of the occluders; None: none.
    """
    start = time.process_time()
    sensors = frozenset(names(SQUARE_ORDER[:CAMERAS]))
    tracking = TrackingTask(config, seed, method=method, sensors=sensors, targets=targets)
    parts = list(track([bearings], scene, tracking, None if priors is None else [priors]))
    return parts, time.process_time() - start


def priors_of(tracks: Tracks) -> Occluders | None:
    """Gaussian priors of occluders from the estimates of tracks; None without rows."""
    if not len(tracks):
        return None
    return Occluders.of(
        t_ns=tracks.t_ns,
        occluder_id=tracks.target_id,
        x=tracks.x,
        y=tracks.y,
        cov_xx=tracks.cov_xx,
        cov_xy=tracks.cov_xy,
        cov_yy=tracks.cov_yy,
    )


def joint_states(size: Size, execute: Execute) -> Table:
    """Table of RMSE, CPU time and effective particles against the number of objects, target included."""
    counts = (1, 4) if size.quick else (1, 2, 4, 9, 19)
    plain = {"scene": square_room(pillar=True), "steps": size.steps, "particles": size.particles}
    specs = [{**plain, "others": m, "seed": size.seed + run} for run in range(size.runs) for m in counts]
    results = execute(specs)
    table = []
    for i, m in enumerate(counts):
        own = results[i :: len(counts)]
        table += [_row(name, m + 1, own) for name in (JOINT, SEPARATE, NONE)]
    return table


def _row(name: str, objects: int, results: list[dict[str, float]]) -> PaperRow:
    def each(figure: str) -> tuple[float, ...]:
        return tuple(r[f"{name}, {figure}"] for r in results)

    more: Mapping[str, tuple[float, ...]] = {"seconds": each("seconds"), "ess": each("ess")}
    extra = {"mean_ess": float(np.mean(more["ess"])), "track_seconds": float(np.mean(more["seconds"]))}
    return PaperRow(name, objects, each("rmse"), extra, each=dict(more))


def judge(table: Table) -> list[StatementVerdict]:
    """Verdicts on whether one joint state is prohibitive for many objects, and on its error; empty for few rows."""
    joint = v.series(table, JOINT)
    if len(joint) < 2:
        return []
    cost = power_of([PaperRow(JOINT, r.x, r.each["seconds"]) for r in joint])
    ess = [PaperRow(JOINT, r.x, r.each["ess"]) for r in joint]
    statement = "With as many particles the joint filter costs more than in proportion to the objects: exponent."
    grows = v.judge("joint-cost", statement, cost, v.above(1.0), rule="exponent of the number of objects above 1")
    statement = "Of its particles fewer count, by this factor from the fewest objects to the most."
    rule = f"at least {LEFT:g}; in part from {SOME:g} on"
    fewer = v.judge(
        "joint-particles", statement, quotient_of(ess[0], ess[-1]), v.at_least(LEFT), v.at_least(SOME), rule=rule
    )
    both = v.matched(table, SEPARATE, JOINT)
    statement = "Separate filters, then priors, have a lower error than one joint filter of as many particles."
    return [grows, fewer, v.pairs("joint-error", statement, both)]


JOINT_STATES = Experiment(
    item="joint",
    title="One filter for all objects",
    x_label="objects",
    y_label="RMSE",
    runs=5,
    steps=400,
    quick=(2, 20),
    compute=joint_states,
    judge=judge,
    trial=figures_of,
    note="The room of Fig. 6 with four cameras; all objects are targets with labelled bearings, and hide one another.",
)
