"""What priors of moving occluders are worth in a crowd, to `apf` and to its smoother.

The square room of [Ercan] without its pillar, the defaults of the program.  All columns see the same worlds: no priors,
Kalman filters on virtual measurements of deviation 8 by some `temper`, and the places where the occluders truly are.
`python -m benchmarks.track.crowd_priors` prints the table.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from benchmarks.track.simulated import TARGET, room100
from occlog.array_types import Floats
from occlog.core.metrics.errors import normalised_squared_errors
from occlog.measure.priors.from_positions import virtual_priors
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Diagnostics, Tracks, Truth
from occlog.settings import configure
from occlog.simulate.config import ObserveConfig, WorldConfig
from occlog.simulate.sensors.cameras import observe
from occlog.simulate.stage import simulate_truth
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.methods.apf.config import ApfConfig

NAME = "crowd-priors"
SUMMARY = "RMSE of apf --smooth with priors of 40 moving occluders to that without, four cameras"
LIMIT = 1.0
STEPS, SKIP = 250, 20
SIGMA, Q = 8.0, 1.2
"""Of the Kalman filters of the occluders: their RMS error is 6.67."""
NONE, TRUE = "none", "true places"


class World(NamedTuple):
    """One simulated world, and what is seen of its target."""

    scene: Scene
    truth: Truth
    bearings: Bearings
    seed: int


class Outcome(NamedTuple):
    """How one world was tracked."""

    square: float  # mean squared error
    nees: float
    begun: int  # rows in which the filter began anew


def world(occluders: int, cameras: int, seed: int) -> World:
    """The square room with a crowd."""
    scene = replace(room100(cameras), occluders=())
    truth = Truth.concat(simulate_truth(scene, WorldConfig(steps=STEPS, occluders=occluders), seed))
    return World(scene, truth, Bearings.concat(observe(scene, [truth], ObserveConfig(), seed)), seed)


def follow(made: World, priors: str, settings: Mapping[str, Any]) -> Outcome:
    """Track the target of a world; `priors` are `NONE`, `TRUE` or the exponent of uncertain ones."""
    temper = {} if priors in (NONE, TRUE) else {"temper": float(priors)}
    config = configure(ApfConfig(), {**temper, **settings})
    reported = None if priors == NONE else virtual_priors([made.truth], 0.0 if priors == TRUE else SIGMA, Q, made.seed)
    parts = list(track([made.bearings], made.scene, TrackingTask(config, made.seed), reported))
    tracks, filter_diagnostics = (
        Tracks.concat(p.tracks for p in parts),
        Diagnostics.concat(p.diagnostics for p in parts),
    )
    own = made.truth.take(made.truth.target_id == TARGET)
    rows = np.searchsorted(own.t_ns, tracks.t_ns)
    away = np.column_stack([tracks.x - own.x[rows], tracks.y - own.y[rows]])[SKIP:]
    spread = np.stack([tracks.cov_xx, tracks.cov_xy, tracks.cov_xy, tracks.cov_yy], axis=1).reshape(-1, 2, 2)[SKIP:]
    begun = Counter(filter_diagnostics.fallback.tolist())
    nees = float(np.mean(normalised_squared_errors(away, spread)))
    return Outcome(float(np.mean(np.sum(away**2, axis=1))), nees, begun["restart"])


def cell(found: Sequence[Outcome], others: Sequence[Outcome]) -> str:
    """Mean RMSE of the worlds, mean NEES, restarts, and the mean difference of the RMSE to others with its error."""
    rmse, reference = _roots(found), _roots(others)
    gap = rmse - reference
    error = float(np.std(gap, ddof=1)) / math.sqrt(len(gap)) if len(gap) > 1 else math.nan
    more = "" if found is others else f", {gap.mean():+.2f} ({error:.2f})"
    return f"{rmse.mean():.2f}, {np.mean([o.nees for o in found]):.1f}, {sum(o.begun for o in found)}{more}"


def _roots(found: Sequence[Outcome]) -> Floats:
    return np.sqrt([o.square for o in found])


def run(repeats: int = 5) -> dict[str, Any]:
    """Ratio of the mean RMSE of as many worlds as repeats."""
    made = [world(40, 4, seed) for seed in range(repeats)]
    found = {p: [follow(one, p, {"smooth": True}) for one in made] for p in (NONE, "0.3")}
    means = {p: float(_roots(each).mean()) for p, each in found.items()}
    parts = {f"priors {p}: mean RMSE": value for p, value in means.items()}
    return {"ratio": means["0.3"] / means[NONE], "limit": LIMIT, "parts": parts}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--occluders", type=int, nargs="+", default=[40, 160])
    parser.add_argument("--cameras", type=int, nargs="+", default=[4, 8])
    parser.add_argument("--worlds", type=int, default=6)
    parser.add_argument("--priors", nargs="+", default=[NONE, "1", "0.3", TRUE], help="none, true places, or a temper")
    parser.add_argument("--set", dest="settings", action="append", default=[], metavar="NAME=VALUE")
    options = parser.parse_args()
    settings = dict(text.split("=", 1) for text in options.settings)
    print(
        "| occluders, cameras | estimate | "
        + " | ".join(options.priors)
        + " |\n"
        + "|---" * (2 + len(options.priors))
        + "|"
    )
    for occluders in options.occluders:
        for cameras in options.cameras:
            made = [world(occluders, cameras, seed) for seed in range(options.worlds)]
            for estimate, smooth in (("filter", False), ("--smooth", True)):
                found = [[follow(one, p, {"smooth": smooth, **settings}) for one in made] for p in options.priors]
                cells = " | ".join(cell(each, found[0]) for each in found)
                print(f"| {occluders}, {cameras} | {estimate} | {cells} |", flush=True)


if __name__ == "__main__":
    main()
