"""Everybody at once: trackers of several projects on the same boxes of several calibrated cameras.

    python -m benchmarks.track.crowd [--wildtrack ABCD] [--rooms 5,10,20,40] [--grow 4,8,12,16,20]
                                     [--hall-seconds S]
                                     [--only NAME,...] [--seeds 0-2] [--work DIR] [--json]

`--wildtrack` takes the annotated people of WILDTRACK with boxes that are made worse, frames 0 to 199 (left out where
the data is not there); `--rooms` simulated rooms with so many people, four cameras and 10 frames a second; `--grow`
100 people in a hall of 30 x 20 m with more and more cameras.  Tracks on the ground are scored as `occlog evaluate`
scores them, a match within 1 m, over all seeds: mean and standard error.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.peers.views_peer import seeds
from benchmarks.track._crowd_cases import DEGREES, Case, room, wildtrack
from benchmarks.track._crowd_trackers import TRACKERS, Outcome
from occlog.array_types import NS
from occlog.evaluate.mot.config import MultiTargetConfig
from occlog.evaluate.mot.on_ground import evaluate_ground
from occlog.records.tables import Tracks, Truth

NAME = "crowd"
SUMMARY = (
    "jipda, 10 people, 4 cameras, 10 Hz: share of identities lost (1 - IDF1) to that of fused feet with Kalman filters"
)
LIMIT = 0.7
FIGURES = {
    "IDF1": "idf1",
    "MOTA": "mota",
    "switches": "id_switches",
    "RMSE [m]": "matched_rmse_m",
    "NEES": "matched_nees_mean",
    "in 95 %": "matched_nees_share_95",
    "OSPA(2) [m]": "ospa2_m",
    "T-GOSPA [m]": "tgospa_m",
}
"""Columns of the table, and the figures of `evaluate`."""
SECONDS = 20.0
HALL, CROWD, HALL_SECONDS = (30.0, 20.0), 100, 6.0


def scored(case: Case, outcome: Outcome) -> dict[str, float]:
    """Figures of one tracker on one case."""
    frame, person, x, y = case.truth.T
    order = np.lexsort((person, frame))
    truth = Truth.of(
        t_ns=_times(frame, case)[order],
        target_id=person[order].astype(np.int32),
        x=x[order],
        y=y[order],
        z=np.full(len(x), np.nan),
        role=np.full(len(x), "target"),
    )
    rows = outcome.rows[np.lexsort((outcome.rows[:, 1], outcome.rows[:, 0]))]
    reported = np.where(np.isfinite(rows[:, 4:]), rows[:, 4:], 0.0)  # a singular covariance is not judged
    tracks = Tracks.of(
        t_ns=_times(rows[:, 0], case),
        target_id=rows[:, 1].astype(np.int32),
        x=rows[:, 2],
        y=rows[:, 3],
        vx=np.full(len(rows), np.nan),
        vy=np.full(len(rows), np.nan),
        cov_xx=reported[:, 0],
        cov_xy=reported[:, 1],
        cov_yy=reported[:, 2],
    )
    got = evaluate_ground(tracks, truth, MultiTargetConfig.in_unit("m"), None).metrics
    cost = {"ms a frame": 1e3 * outcome.seconds / case.frames, "MB": outcome.megabytes}
    return {name: got[key] for name, key in FIGURES.items()} | cost


def _times(frame: Any, case: Case) -> Any:
    return np.rint(frame * NS / case.fps).astype(np.int64)


def cases(options: argparse.Namespace, seed: int, work: Path) -> Iterator[Case]:
    """The cases of one seed."""
    for setting in options.wildtrack:
        made = wildtrack(setting, seed, work)
        if made is None:
            print(f"wildtrack-{setting}: left out, wildtrack_annotations and tools/crowd are not there")
        else:
            yield made
    for people in options.rooms:
        yield room(people, 4, seed, round(10 * SECONDS), 10.0)
    for cameras in options.grow:
        yield room(CROWD, cameras, seed, round(10 * options.hall_seconds), 10.0, HALL)


def measured(options: argparse.Namespace, work: Path) -> dict[str, dict[str, dict[str, list[float]]]]:
    """Figures by case, tracker and column, a value for each seed."""
    out: dict[str, dict[str, dict[str, list[float]]]] = {}
    for seed in options.seeds:
        for case in cases(options, seed, work):
            for name in options.only:
                outcome = TRACKERS[name](case, work)
                row = scored(case, outcome)
                columns = out.setdefault(case.name, {}).setdefault(name, {})
                for figure, value in row.items():
                    columns.setdefault(figure, []).append(value)
                reported = "  ".join(f"{k} {v:.3f}" for k, v in row.items())
                print(f"{case.name} {seed} {name}: {reported}", flush=True)
    return out


def cell(values: list[float]) -> str:
    """Mean and standard error for a person."""
    mean = float(np.mean(values))
    digits = 1 if abs(mean) >= 20 else 3
    if not np.isfinite(mean):
        return "–"
    if len(values) < 2:
        return f"{mean:.{digits}f}"
    return f"{mean:.{digits}f} ± {np.std(values, ddof=1) / np.sqrt(len(values)):.{digits}f}"


def show(title: str, found: dict[str, dict[str, list[float]]]) -> None:
    """A table in Markdown."""
    names = list(next(iter(found.values())))
    print(f"\n{title}\n\n| tracker | {' | '.join(names)} |\n|---|{'---|' * len(names)}")
    for tracker, got in found.items():
        print(f"| {tracker} | {' | '.join(cell(got[name]) for name in names)} |")


def run(repeats: int = 5) -> dict[str, Any]:
    """Share of identities lost to that of the baseline: mean over as many seeds as repeats."""
    lost: dict[str, list[float]] = {"jipda": [], "baseline": []}
    times = []
    with tempfile.TemporaryDirectory() as scratch:
        for seed in range(repeats):
            case = room(10, 4, seed, 100, 10.0)
            for name, values in lost.items():
                got = scored(case, TRACKERS[name](case, Path(scratch)))
                values.append(1.0 - got["IDF1"])
                times += [got["ms a frame"]] if name == "jipda" else []
    mine, theirs = float(np.mean(lost["jipda"])), float(np.mean(lost["baseline"]))
    parts = {"jipda 1 - IDF1": mine, "baseline 1 - IDF1": theirs, "jipda ms a frame": float(np.median(times))}
    return {"ratio": mine / theirs, "limit": LIMIT, "parts": parts}


def _numbers(text: str) -> list[int]:
    return [int(part) for part in text.split(",") if part]


def main() -> None:
    """Run all trackers on all cases."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.track.crowd",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--wildtrack", default="", metavar="ABCD", help=f"settings, of {''.join(DEGREES)}")
    parser.add_argument("--rooms", type=_numbers, default=[], metavar="N,...", help="numbers of people")
    parser.add_argument("--grow", type=_numbers, default=[], metavar="N,...", help="numbers of cameras in the hall")
    parser.add_argument("--hall-seconds", type=float, default=HALL_SECONDS, help=f"default {HALL_SECONDS:g}")
    parser.add_argument("--only", metavar="NAME;...", help=f"these trackers; of {'; '.join(TRACKERS)}")
    parser.add_argument("--seeds", type=seeds, default=seeds("0-2"), help="default 0-2")
    parser.add_argument("--work", type=Path, help="keep recordings and environments here")
    parser.add_argument("--json", action="store_true", help="one JSON object at the end")
    options = parser.parse_args()
    options.only = [n.strip() for n in options.only.split(";")] if options.only else list(TRACKERS)
    if unknown := [n for n in options.only if n not in TRACKERS]:
        parser.error(f"no tracker {unknown[0]!r}; there are {'; '.join(TRACKERS)}")
    with tempfile.TemporaryDirectory() as scratch:
        work = options.work or Path(scratch)
        work.mkdir(parents=True, exist_ok=True)
        found = measured(options, work)
    for title, rows in found.items():
        show(title, rows)
    if options.json:
        print(json.dumps(found, sort_keys=True))


if __name__ == "__main__":
    main()
