"""`apf` among sharp cameras, filtered and smoothed, beside filterpy's extended Kalman filter and smoother.

One person in a room of 10 x 8 m with four cameras in the corners, 5 frames a second, 30 % of the looks missed, the
defaults of the program.  `python -m benchmarks.track.sharp` prints the whole table (five motions, focal lengths,
noises; about 20 minutes); `python -m benchmarks sharp` a part of it.

The peer is given what `apf` has to find: which strength of white acceleration is best for each motion, chosen by the
true errors, and a start 0.3 m off the truth.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.peers._environments import environment, output_of
from benchmarks.track._metric_rooms import MOTIONS, RATE, Recording, record
from benchmarks.track.false_bearings import ELLIPSE, follow
from occlog.array_types import Floats
from occlog.core.metrics.errors import normalised_squared_errors

NAME = "sharp"
SUMMARY = "RMSE of apf to that of filterpy's best EKF, four cameras of 600 px, 3 px of noise, five kinds of motion"
LIMIT = 1.1
VARIABLE = "OCCLOG_FILTERPY"
"""Folder of an environment with filterpy; without it one is made anew."""
PACKAGES = ("filterpy==2.0.0",)
STRENGTHS = (0.1, 0.3, 0.6, 1.0, 2.0, 4.0, 8.0)
SKIP_S = 2.0
SEEDS = 8
FOCAL_PX, SIGMA_PX = (70.0, 150.0, 300.0, 600.0, 1000.0), (0.5, 1.0, 3.0, 5.0)
ESTIMATES = {"apf": {}, "apf, lag 1 s": {"lag_s": 1.0}, "apf, smoothed": {"smooth": True}}


class Score(NamedTuple):
    """How well the recordings of one setting were tracked, over all of them."""

    rmse: float  # [m]
    nees: float  # mean normalised squared error; 2 is consistent
    outside: float  # share of the rows outside the stated 95 % ellipse
    ms: float  # a step

    def cell(self) -> str:
        """The figures in a cell of a table."""
        nees = f"{self.nees:.2f}" if self.nees < 100.0 else f"{self.nees:.0e}"
        return f"{self.rmse:.4f}, {nees}, {self.outside:.3f}"


def recordings(motion: str, focal_px: float, sigma_px: float, seeds: Sequence[int]) -> list[Recording]:
    """The recordings of one setting."""
    return [record(motion, focal_px=focal_px, sigma_px=sigma_px, seed=seed) for seed in seeds]


def score(made: Sequence[Recording], settings: dict[str, Any]) -> Score:
    """Track recordings by the code of `occlog track`."""
    follow(made[0], "apf", settings, SKIP_S)  # compile
    begin = time.process_time()
    found = [follow(one, "apf", settings, SKIP_S) for one in made]
    ms = 1e3 * (time.process_time() - begin) / sum(len(one.t_ns) for one in made)
    nees = np.concatenate([outcome.nees for outcome in found])
    rmse = float(np.sqrt(np.mean([outcome.rmse**2 for outcome in found])))
    return Score(rmse, float(nees.mean()), float(np.mean(nees > ELLIPSE)), ms)


def best_peers(made: Sequence[Recording], python: Path, folder: Path) -> dict[str, Score]:
    """The filter and smoother of filterpy with the strength that has the least error, the same for all recordings."""
    cameras = [[(*c.ground, c.yaw, c.focal_px[0]) for c in one.scene.cameras] for one in made]
    sigma = [one.scene.cameras[0].sigma_read_px for one in made]
    start = [one.xy[0] + np.random.default_rng(k).normal(0.0, 0.3 / np.sqrt(2.0), 2) for k, one in enumerate(made)]
    given = {"z": [readings(one) for one in made], "cameras": cameras, "sigma": sigma, "start": start}
    np.savez(folder / "recordings.npz", **{k: np.array(v) for k, v in given.items()}, q=STRENGTHS, dt=1.0 / RATE)
    runs = output_of(python, "_filterpy_filters.py", folder / "recordings.npz")["runs"]
    return {
        name: min((_judged(made, [one[name] for one in of_q]) for of_q in runs), key=lambda s: s.rmse)
        for name in ("filter", "smoother")
    }


def readings(one: Recording) -> Floats:
    """(T, S) readings z = -u [px]; NaN: not seen."""
    names = [c.name for c in one.scene.cameras]
    out = np.full((len(one.t_ns), len(names)), np.nan)
    seen, b = one.bearings.seen, one.bearings
    columns = [names.index(name) for name in b.sensor[seen].tolist()]
    out[np.searchsorted(one.t_ns, b.t_ns[seen]), columns] = -b.u_px[seen]
    return out


def _judged(made: Sequence[Recording], runs: Sequence[dict[str, Any]]) -> Score:
    late = round(SKIP_S * RATE)
    away = np.concatenate([np.array(run["xy"])[late:] - one.xy[late:] for one, run in zip(made, runs, strict=True)])
    nees = normalised_squared_errors(away, np.concatenate([np.array(run["cov"])[late:] for run in runs]))
    rmse, ms = float(np.sqrt(np.mean(np.sum(away**2, axis=1)))), float(np.mean([run["ms"] for run in runs]))
    return Score(rmse, float(nees.mean()), float(np.mean(nees > ELLIPSE)), ms)


def table(
    motions: Sequence[str],
    focal: Sequence[float],
    noise: Sequence[float],
    seeds: Sequence[int],
    estimates: Sequence[str] = tuple(ESTIMATES),
) -> dict[tuple[str, float, float], dict[str, Score]]:
    """Scores of every estimate in every setting, printed as they come."""
    found = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        python = environment(Path(os.environ.get(VARIABLE) or folder / "peer"), *PACKAGES)
        for motion in motions:
            for f in focal:
                for px in noise:
                    made = recordings(motion, f, px, seeds)
                    scores = {label: score(made, ESTIMATES[label]) for label in estimates}
                    peers = best_peers(made, python, folder)
                    scores |= {"EKF": peers["filter"], "EKF + RTS": peers["smoother"]}
                    found[motion, f, px] = scores
                    ms = ", ".join(f"{s.ms:.2f}" for s in scores.values())
                    cells = " | ".join(s.cell() for s in scores.values())
                    print(f"| {motion} | {f:g} | {px:g} | {cells} | {ms} |", flush=True)
    return found


def header(estimates: Sequence[str] = tuple(ESTIMATES)) -> str:
    """The head of the table."""
    names = ["motion", "f [px]", "noise [px]", *estimates, "EKF", "EKF + RTS", "ms a step"]
    return "| " + " | ".join(names) + " |\n" + "|---" * len(names) + "|"


def run(repeats: int = 5) -> dict[str, Any]:
    """Ratio of the root-mean-square errors over the motions, with as many seeds as repeats."""
    print(header())
    found = table(MOTIONS, (600.0,), (3.0,), range(repeats))
    parts: dict[str, Any] = {}
    for (motion, _, _), scores in found.items():
        parts |= {f"{motion}, {name}": s.cell() for name, s in scores.items()}
    ratios = [scores["apf"].rmse / scores["EKF"].rmse for scores in found.values()]
    return {"ratio": float(np.exp(np.mean(np.log(ratios)))), "limit": LIMIT, "parts": parts}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--motion", nargs="+", default=list(MOTIONS), choices=MOTIONS)
    parser.add_argument("--focal-px", type=float, nargs="+", default=list(FOCAL_PX))
    parser.add_argument("--sigma-px", type=float, nargs="+", default=list(SIGMA_PX))
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--estimates", nargs="+", default=list(ESTIMATES), choices=ESTIMATES)
    options = parser.parse_args()
    print(header(options.estimates))
    table(options.motion, options.focal_px, options.sigma_px, range(options.seeds), options.estimates)


if __name__ == "__main__":
    main()
