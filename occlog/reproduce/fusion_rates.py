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
DETECTED, REPORTED = "detected", "false"
RATES = {"detection": DETECTED, "false": REPORTED}
RAW, IGNORE, USE = "not fused", "fused", "fused, all used"
TRACKED = {"rmse_raw": RAW, "rmse_ignore": IGNORE, "rmse_use": USE}
NOTE = f"Reference room of 100 x 100; series: number of cameras, each of which misses {MISS:.0%} of what it could see."


def rates(size: Size, execute: Execute) -> Table:
    """Rates of all cameras against the probability of a false report, before and after."""
    rows = []
    for n, x, own in _done(size, execute, track=False):
        extra = {key: math.fsum(r[key] for r in own) / size.runs for key in ("hidden_before", "hidden_after")}
        extra["nees_recovered"] = math.fsum(r["nees_recovered"] for r in own) / size.runs
        for key, what in RATES.items():
            for when in ("before", "after"):
                rows.append(Row(f"{n}, {what}, {when}", x, tuple(r[f"{key}_{when}"] for r in own), extra))
    return rows


def errors(size: Size, execute: Execute) -> Table:
    """RMSE of the auxiliary particle filter against the probability of a false report."""
    return [
        Row(f"{n}, {what}", x, tuple(r[key] for r in own))
        for n, x, own in _done(size, execute, track=True)
        for key, what in TRACKED.items()
    ]


def _done(size: Size, execute: Execute, *, track: bool) -> list[tuple[int, float, list[dict[str, float]]]]:
    """Cameras, probability of a false report, and the figures of all runs."""
    cameras = CAMERAS[1:2] if size.quick else CAMERAS
    points = [(n, x) for n in cameras for x in (FALSE[::2] if size.quick else FALSE)]
    results = execute([_spec(size, run, n, x, track) for n, x in points for run in range(size.runs)])
    return [(n, x, results[i * size.runs : (i + 1) * size.runs]) for i, (n, x) in enumerate(points)]


def _spec(size: Size, run: int, cameras: int, false: float, track: bool) -> Spec:
    return {
        "kind": "lee-fusion", "scene": square_room(pillar=True), "seed": size.seed, "run": run, "steps": size.steps,
        "occluders": 0, "cameras": names(SQUARE_ORDER[:cameras]), "miss": MISS, "false": false, "track": track,
    }  # fmt: skip


def judge_rates(table: Table) -> list[Verdict]:
    """Statements of the thesis about the fusion."""
    missed = "Missed detections are recovered: detection rate higher by this"
    false = "False detections do not spread: fewer false reports a frame, by this"
    return [
        *_judged(table, "detection", missed, f"{DETECTED}, before", f"{DETECTED}, after"),
        *_judged(table, "false", false, f"{REPORTED}, after", f"{REPORTED}, before"),
    ]


def judge_errors(table: Table) -> list[Verdict]:
    """Statements of this project about tracking with fused bearings."""
    gains = "A filter gains by the fusion, recovered rows as not seen (of this project): RMSE lower by this"
    twice = "Recovered rows as measured count the same twice (of this project): RMSE higher by this"
    return [*_judged(table, "fused", gains, IGNORE, RAW), *_judged(table, "twice", twice, IGNORE, USE)]


def _judged(table: Table, key: str, said: str, low: str, high: str) -> list[Verdict]:
    """That one series is below another, for each number of cameras."""
    found = [(n, v.matched(table, f"{n}, {low}", f"{n}, {high}")) for n in CAMERAS]
    return [v.pairs(f"{key}-{n}", f"{said}; {n} cameras.", points) for n, points in found if points]


EXPERIMENTS = (
    Experiment(
        "detection", "Detections before and after the fusion", "probability of a false report", "rate",
        12, 400, (2, 60), rates, judge_rates, trial=fusion_trial,
        note=f"{NOTE} Detected: share of the looks at a visible target; false: a frame.",
    ),
    Experiment(
        "fused-track", "A particle filter on fused bearings", "probability of a false report", "RMSE",
        6, 300, (2, 60), errors, judge_errors, trial=fusion_trial,
        note=f"{NOTE} Recovered rows are taken as not seen, or (all used) as measured.",
    ),
)  # fmt: skip
