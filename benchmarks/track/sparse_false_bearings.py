"""False bearings where cameras do not overlap: [Rahimi] Sec. 6, RMSE and NEES over shares of false bearings.

`python -m benchmarks.track.sparse_false_bearings` prints a line for each share;
`--set loss=cauchy --set initialisation=axes`
and the like change the method.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from benchmarks.track._batch_problem import sparse_config
from occlog.array_types import Floats
from occlog.consistency.estimates import covariances
from occlog.core.metrics.errors import normalised_squared_errors
from occlog.papers.rahimi.example import example, sparse_scene
from occlog.records.tables import Tracks
from occlog.settings import configure
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.run import TrackSummary

NAME = "sparse-false-bearings"
SUMMARY = "mean NEES of map with 10 % false bearings, cameras that do not overlap"
LIMIT = 3.0
STEPS = 200


class Outcome(NamedTuple):
    """How one problem was solved."""

    rmse: float
    nees: Floats  # (T,)
    unobservable: float  # share of the rows that say so
    said: frozenset[str]  # codes of warnings


def solve(run: int, false: float, settings: Mapping[str, Any]) -> Outcome:
    """One random problem with a share of false bearings, by the code of `occlog track`."""
    made, scene = example(0, run, STEPS, false), sparse_scene(known_range=False)
    parts = list(track([made.bearings], scene, TrackingTask(configure(sparse_config(), settings), 0, method="map")))
    tracks, summary = Tracks.concat(p.tracks for p in parts), TrackSummary(scene, joint=False)
    for part in parts:
        summary.add(part)
    true = np.column_stack([made.truth.x, made.truth.y])[np.searchsorted(made.truth.t_ns, tracks.t_ns)]
    away = np.column_stack([tracks.x, tracks.y]) - true
    return Outcome(
        rmse=float(np.sqrt(np.mean(np.sum(away**2, axis=1)))),
        nees=normalised_squared_errors(away, covariances(tracks)),
        unobservable=summary.evidence.fallbacks["unobservable"] / len(tracks),
        said=frozenset(f.id for f in summary.checks() if f.status == "failed"),
    )


def run(repeats: int = 5) -> dict[str, Any]:
    """Mean NEES over as many problems as repeats times five."""
    found = [solve(n, 0.1, {}) for n in range(5 * repeats)]
    parts = {"median RMSE [m]": float(np.median([o.rmse for o in found]))}
    return {"ratio": float(np.concatenate([o.nees for o in found]).mean()), "limit": LIMIT, "parts": parts}


def main() -> None:
    """Print a table: a row for each share of false bearings."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--false", type=float, nargs="+", default=[0.0, 0.05, 0.1, 0.2])
    parser.add_argument("--problems", type=int, default=24)
    parser.add_argument("--set", dest="settings", action="append", default=[], metavar="NAME=VALUE")
    options = parser.parse_args()
    settings = dict(text.split("=", 1) for text in options.settings)
    print("| false | RMSE: median, mean | NEES: mean, median of problems | flagged | warned of |\n" + "|---" * 5 + "|")
    for false in options.false:
        found = [solve(n, false, settings) for n in range(options.problems)]
        rmse, nees = np.array([o.rmse for o in found]), [o.nees for o in found]
        codes = {c: sum(c in o.said for o in found) for c in sorted(frozenset().union(*(o.said for o in found)))}
        cells = f"{np.median(rmse):.2f}, {rmse.mean():.2f} | {np.concatenate(nees).mean():.3g}, "
        cells += f"{np.median([n.mean() for n in nees]):.1f} | {np.mean([o.unobservable for o in found]):.0%} | {codes}"
        print(f"| {false:.0%} | {cells} |", flush=True)


if __name__ == "__main__":
    main()
