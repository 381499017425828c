"""Trials of the auxiliary particle filter, and the rows of a table made of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from occlog.io.scenes.scene import scene_from_yaml
from occlog.papers.verdicts.measures import mean_of, sample
from occlog.papers.verdicts.model import EXTRAS, Execute, Row, Size, Table, Verdict
from occlog.papers.verdicts.verdicts import find, stated
from occlog.pipeline.sweep.trial import Spec, Values
from occlog.settings import configure
from occlog.simulate.config import WorldConfig
from occlog.simulate.stage import simulate_truth

WORST = "no tracking (middle of the room)"
NONE, KNOWN, PRIOR = "no priors", "positions known", "priors"
EACH = ("rmse_occ",)
"""Figures of trials that are judged, too."""


class Point(NamedTuple):
    """One point of a figure: the description of its trials, without the number of the run."""

    series: str
    x: float
    spec: Spec


def trial(
    scene: str,
    size: Size,
    simulate: Values,
    priors: Values,
    *,
    cameras: Sequence[str] | None = None,
    **more: Any,
) -> Spec:
    """Describe a trial of `occlog.pipeline.sweep.trial.run_trial`.

    Args:
        scene: scene file as text.
        size: steps, particles and seed.
        simulate: settings of the simulated world besides its steps.
        priors: kind and settings of the occluders' priors.
        cameras: names of the cameras that are used; None: all.
        more: further entries; those of `track` are settings of the filter.
    """
    spec = {
        "scene": scene,
        "seed": size.seed,
        "simulate": {"steps": size.steps, **simulate},
        "priors": dict(priors),
        "track": {"method": "apf", "particles": size.particles, "temper": 1.0, **more.pop("track", {})},
        **more,
    }
    return spec if cameras is None else {**spec, "cameras": list(cameras)}


def run_points(points: Sequence[Point], size: Size, execute: Execute) -> Table:
    """Run all trials and return a row for every point, with the RMSE of each run; equal runs share the world."""
    specs = [{**p.spec, "run": run} for run in range(size.runs) for p in points]
    results = execute(specs)
    return [_row(p, results[i :: len(points)]) for i, p in enumerate(points)]


def _row(point: Point, results: Sequence[Mapping[str, float]]) -> Row:
    extra = {}
    for name in EXTRAS:
        values = [r[name] for r in results if name in r and not math.isnan(r[name])]
        extra[name] = math.fsum(values) / len(values) if values else math.nan
    each = {name: tuple(r[name] for r in results) for name in EACH if all(name in r for r in results)}
    return Row(point.series, point.x, tuple(r["rmse"] for r in results), extra, each=each)


def worst_case(scene_text: str, simulate: Values, size: Size) -> Row:
    """Return RMSE_max of [Ercan] Sec. 6.1: the error of the middle of the room's bounding box as the estimate.

    The targets are drawn as those of the trials, without moving occluders.
    """
    scene = scene_from_yaml(scene_text, "scene")
    few = {**simulate, "steps": size.steps, "occluders": 0}
    config: WorldConfig = configure(WorldConfig.in_unit(scene.length_unit), few)
    middle = 0.5 * (scene.region.min(axis=0) + scene.region.max(axis=0))
    values = []
    for run in range(size.runs):
        total, count = 0.0, 0
        for chunk in simulate_truth(scene, config, size.seed + run):
            total += float(((chunk.x - middle[0]) ** 2 + (chunk.y - middle[1]) ** 2).sum())
            count += len(chunk)
        values.append(math.sqrt(total / count))
    return Row(WORST, math.nan, tuple(values))


def judge_worst_case(table: Table, item: str, paper: float) -> list[Verdict]:
    """Judge the error without tracking, the row of `worst_case`, against that of the paper."""
    row = find(table, WORST)
    if row is None:
        return []
    said = "Error without tracking, of the middle of the room."
    return [stated(f"{item}-rmse-max", said, paper, mean_of(row))]


def priors_error(item: str, rows: Sequence[Row], paper: float) -> list[Verdict]:
    """Judge the error of the priors, the mean over the rows with priors, run by run."""
    given = [own for r in rows if (own := r.each.get("rmse_occ")) and min(own) > 0.0]
    if not given:
        return []
    of_runs = sample([math.fsum(own) / len(own) for own in zip(*given, strict=True)])
    said = "Error of the occluders' priors (set by the noise of the virtual measurements)."
    return [stated(f"{item}-rmse-occ", said, paper, of_runs)]


def kalman(sigma: float, q: float = 1.2) -> Values:
    """Describe priors by a Kalman filter on virtual measurements of deviation `sigma`; 0 means known positions."""
    return {"kind": "kalman", "sigma": sigma, "q": q} if sigma > 0 else {"kind": "known"}
