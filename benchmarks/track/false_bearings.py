"""False bearings in metric rooms: RMSE, NEES and coverage over motions, cameras and shares of false bearings.

`python -m benchmarks false-bearings` measures `map`; any other method and setting by
`python -m benchmarks.track.false_bearings --method fix --cameras 4 --false 0 0.1`.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from benchmarks.track._metric_rooms import MOTIONS, Recording, record
from occlog.array_types import Floats
from occlog.core.metrics.errors import normalised_squared_errors
from occlog.records.tables import Tracks
from occlog.settings import configure
from occlog.track.catalogue import settings_of
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask

NAME = "false-bearings"
SUMMARY = "RMSE of map with 10 % false bearings to that without, four sharp cameras, five kinds of motion"
LIMIT = 1.3
ELLIPSE = 5.991
"""95 % of a chi-squared variable with two degrees of freedom."""
FIRST_SEED = 100


class Outcome(NamedTuple):
    """How one recording was tracked."""

    rmse: float
    nees: Floats  # (T,)
    given: float  # share of times with an estimate


def follow(recording: Recording, method: str, settings: Mapping[str, Any], skip_s: float = 0.0) -> Outcome:
    """Track one recording by the code of `occlog track`; the first `skip_s` seconds do not count."""
    config = configure(settings_of(method).in_unit("m"), settings)
    parts = track([recording.bearings], recording.scene, TrackingTask(config, 0, method=method))
    tracks = Tracks.concat(p.tracks for p in parts)
    tracks = tracks.take(tracks.t_ns >= recording.t_ns[0] + round(skip_s * 1e9))
    away = np.column_stack([tracks.x, tracks.y]) - recording.xy[np.searchsorted(recording.t_ns, tracks.t_ns)]
    spread = np.stack([tracks.cov_xx, tracks.cov_xy, tracks.cov_xy, tracks.cov_yy], axis=1).reshape(-1, 2, 2)
    return Outcome(
        rmse=float(np.sqrt(np.mean(np.sum(away**2, axis=1)))),
        nees=normalised_squared_errors(away, spread),
        given=len(tracks) / len(recording.t_ns),
    )


def run(repeats: int = 5) -> dict[str, Any]:
    """Ratio of the root-mean-square errors over motions and as many seeds as repeats."""
    parts: dict[str, Any] = {}
    squares = {}
    for false in (0.0, 0.1):
        seeds = [FIRST_SEED + k for k in range(repeats)]
        found = [follow(record(m, 4, false=false, seed=s), "map", {}) for m in MOTIONS for s in seeds]
        squares[false] = float(np.mean([o.rmse**2 for o in found]))
        parts[f"{false:.0%} false: RMSE [m]"] = squares[false] ** 0.5
        parts[f"{false:.0%} false: mean NEES"] = float(np.mean(np.concatenate([o.nees for o in found])))
    return {"ratio": (squares[0.1] / squares[0.0]) ** 0.5, "limit": LIMIT, "parts": parts}


def main() -> None:
    """Print a table of one method: a row for each number of cameras and share of false bearings."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--method", default="map")
    parser.add_argument("--set", dest="settings", action="append", default=[], metavar="NAME=VALUE")
    parser.add_argument("--seeds", type=int, nargs="+", default=[FIRST_SEED, FIRST_SEED + 1])
    parser.add_argument("--cameras", type=int, nargs="+", default=[2, 3, 4, 8])
    parser.add_argument("--false", type=float, nargs="+", default=[0.0, 0.05, 0.1, 0.2])
    parser.add_argument("--focal-px", type=float, default=600.0)
    parser.add_argument("--sigma-px", type=float, default=3.0)
    parser.add_argument("--miss", type=float, default=0.3)
    parser.add_argument("--asynchronous", action="store_true", help="one camera alone looks at each time, in turn")
    parser.add_argument("--skip", type=float, default=0.0, metavar="SECONDS", help="the first ones do not count")
    options = parser.parse_args()
    settings = dict(text.split("=", 1) for text in options.settings)
    print("| false | cameras | " + " | ".join(MOTIONS) + " |\n" + "|---" * (2 + len(MOTIONS)) + "|")
    for false in options.false:
        for cameras in options.cameras:
            cells = []
            for motion in MOTIONS:
                how = {"focal_px": options.focal_px, "sigma_px": options.sigma_px, "miss": options.miss}
                found = [
                    follow(
                        record(motion, cameras, false=false, seed=s, asynchronous=options.asynchronous, **how),
                        options.method,
                        settings,
                        options.skip,
                    )
                    for s in options.seeds
                ]
                nees = np.concatenate([o.nees for o in found])
                rmse, outside = float(np.median([o.rmse for o in found])), float(np.mean(nees > ELLIPSE))
                cells.append(f"{rmse:.3f}, {nees.mean():.1f}, {outside:.0%}")
            print(f"| {false:.0%} | {cameras} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
