"""[Lee] Ch. 4 on simulated cameras: detection and false rates before and after the fusion, and what a tracker gains."""

from __future__ import annotations

import math

from . import verdicts as v
from .fusion_trial import fusion_trial
from .model import Execute, Experiment, Row, Size, Spec, Table, Verdict
from .scenes import SQUARE_ORDER, names, square_room

MISS = 0.2
FALSE = (0.05, 0.1, 0.2)
CAMERAS = (3, 4, 8)
RATES = {"detection": "detection rate", "false": "false reports a frame"}
TRACKED = {"rmse_raw": "raw", "rmse_ignore": "fused, recovered as not seen", "rmse_use": "fused, recovered as measured"}


def rates(size: Size, execute: Execute) -> Table:
    """Rates of all cameras against the probability of a false report, before and after; RMSE of the filter."""
    cameras = CAMERAS[1:2] if size.quick else CAMERAS
    points = [(n, x) for n in cameras for x in (FALSE[::2] if size.quick else FALSE)]
    specs = [_spec(size, run, n, x) for n, x in points for run in range(size.runs)]
    results, rows = execute(specs), []
    for i, (n, x) in enumerate(points):
        own = results[i * size.runs : (i + 1) * size.runs]
        extra = {key: math.fsum(r[key] for r in own) / size.runs for key in ("hidden_before", "hidden_after")}
        extra["nees_recovered"] = math.fsum(r["nees_recovered"] for r in own) / size.runs
        for key, what in RATES.items():
            for when in ("before", "after"):
                rows.append(Row(f"{n} cameras, {what}, {when}", x, tuple(r[f"{key}_{when}"] for r in own), extra))
        for key, what in TRACKED.items():
            rows.append(Row(f"{n} cameras, RMSE, {what}", x, tuple(r[key] for r in own)))
    return rows


def _spec(size: Size, run: int, cameras: int, false: float) -> Spec:
    return {
        "kind": "lee-fusion", "scene": square_room(pillar=True), "seed": size.seed, "run": run, "steps": size.steps,
        "occluders": 0, "cameras": names(SQUARE_ORDER[:cameras]), "miss": MISS, "false": false, "track": True,
    }  # fmt: skip


def judge_rates(table: Table) -> list[Verdict]:
    """Statements of the thesis about the fusion, and of this project about tracking with its results."""
    out = []
    for n in CAMERAS:
        name = f"{n} cameras"
        for key, what, low, high, said in (
            ("detection", "detection rate", "before", "after", "Missed detections are recovered: rate higher by this."),
            ("false", "false reports a frame", "after", "before", "False detections do not spread: fewer by this."),
        ):
            points = v.matched(table, f"{name}, {what}, {low}", f"{name}, {what}, {high}")
            if points:
                out.append(v.pairs(f"detection-{n}-{key}", f"{said} {name}.", points))
        raw, ignore, use = (f"{name}, RMSE, {what}" for what in TRACKED.values())
        for key, low, high, said in (
            ("fused", ignore, raw, "A filter gains by the fusion, recovered rows as not seen: RMSE lower by this."),
            ("use", ignore, use, "Recovered rows as measured count the same twice: RMSE higher by this."),
        ):
            points = v.matched(table, low, high)
            if points:
                out.append(v.pairs(f"detection-{n}-{key}", f"{said} {name} (of this project).", points))
    return out


EXPERIMENTS = (
    Experiment(
        "detection", "Detection and false rates before and after the fusion", "probability of a false report", "rate",
        12, 400, (2, 60), rates, judge_rates, trial=fusion_trial,
        note=f"Reference room of 100 x 100; each camera misses {MISS:.0%} of what it could see.",
    ),
)  # fmt: skip
