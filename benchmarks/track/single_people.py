"""Single real people with known identities, some bearings false: RMSE, lost ones, coverage, false bearings found.

`python -m benchmarks single-people` measures `map`; any other method and setting by
`python -m benchmarks.track.single_people --method apf --set smooth=true --seeds 10 11 12`, with some of the cameras by
`--select greedy --count 3`.  `--write FOLDER` writes the people of the first seed as files for `occlog track` and
`occlog evaluate`, and prints what the benchmark makes of each.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.track._single_people import Noise, Person, annotations, people, scene_of
from occlog.array_types import Bools, Floats
from occlog.core.metrics.errors import normalised_squared_errors
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.scenes.scene import scene_to_yaml
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Residuals, Tracks, Truth
from occlog.settings import configure
from occlog.track.catalogue import settings_of
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.methods.apf.config import SelectConfig

NAME = "single-people"
SUMMARY = "median RMSE [m] of map on real people (WILDTRACK), 4 px noise, 15 % misses, 5 % false bearings"
LIMIT = 0.075
FAR, LONG = 1.0, 5
"""Lost: more than so far off [m] for so many frames in a row."""
ELLIPSE = 5.991
"""95 % of a chi-squared variable with two degrees of freedom."""
FIRST_SEED = 100


class Outcome(NamedTuple):
    """How one person was tracked."""

    target: int
    rmse: float  # [m] over all frames with an estimate
    given: float  # share of frames that have one
    lost: bool
    nees: Floats  # (T,)
    caught: int  # false bearings that were not believed
    blamed: int  # bearings that were not believed
    false: int  # false bearings
    frames: int  # frames of cameras that were used


def follow(
    person: Person,
    scene: Scene,
    method: str,
    settings: Mapping[str, Any],
    seed: int = 0,
    selection: SelectConfig | None = None,
) -> Outcome:
    """Track one person by the code of `occlog track`."""
    config = configure(settings_of(method).in_unit(scene.length_unit), settings)
    parts = list(track([person.bearings], scene, TrackingTask(config, seed, method=method, selection=selection)))
    tracks = Tracks.concat(p.tracks for p in parts)
    at = np.searchsorted(person.t_ns, tracks.t_ns)
    away = np.column_stack([tracks.x, tracks.y]) - person.xy[at]
    off = np.full(len(person.t_ns), math.inf)
    off[at] = np.hypot(*away.T)
    spread = np.stack([tracks.cov_xx, tracks.cov_xy, tracks.cov_xy, tracks.cov_yy], axis=1).reshape(-1, 2, 2)
    caught, blamed = _doubts(person, [p.residuals for p in parts if p.residuals is not None])
    return Outcome(
        target=person.target,
        rmse=float(np.sqrt(np.mean(np.sum(away**2, axis=1)))),
        given=len(at) / len(off),
        lost=longest(off > FAR) >= LONG,
        nees=normalised_squared_errors(away, spread),
        caught=caught,
        blamed=blamed,
        false=int(np.count_nonzero(person.false)),
        frames=sum(int(p.diagnostics.n_observing.sum()) for p in parts),
    )


def _doubts(person: Person, parts: list[Residuals]) -> tuple[int, int]:
    """How many false bearings are not believed, and how many bearings in all."""
    residuals = Residuals.concat(parts)
    false = set(zip(*_keys(person.bearings.take(person.false)), strict=True))
    doubted = set(zip(*_keys(residuals.take(residuals.inlier_probability < 0.5)), strict=True))
    return len(false & doubted), len(doubted)


def _keys(table: Bearings | Residuals) -> tuple[list[int], list[str]]:
    return table.t_ns.tolist(), table.sensor.tolist()


def longest(rows: Bools) -> int:
    """Length of the longest run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], rows, [False]]).astype(np.int8)))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def measure(
    method: str,
    settings: Mapping[str, Any],
    noise: Noise,
    seeds: list[int],
    *,
    room: bool = False,
    selection: SelectConfig | None = None,
) -> dict[str, Any]:
    """Figures over all people and seeds."""
    folder = annotations()
    if folder is None:
        raise SystemExit(
            "single-people: wildtrack_annotations not found; set OCCLOG_SHARED_DATA to the folder it is in"
        )
    scene = scene_of(folder, room=room)
    found: list[Outcome] = []
    began = time.process_time()
    for seed in seeds:
        found += [follow(p, scene, method, settings, seed, selection) for p in people(folder, scene, noise, seed)]
    rmse = np.array([o.rmse for o in found])
    nees = np.concatenate([o.nees for o in found])
    false, blamed, caught = (sum(getattr(o, k) for o in found) for k in ("false", "blamed", "caught"))
    return {
        "people and seeds": len(found),
        "median RMSE [m]": float(np.median(rmse)),
        "mean RMSE [m]": float(rmse.mean()),
        "90 % RMSE [m]": float(np.quantile(rmse, 0.9)),
        "largest RMSE [m]": float(rmse.max()),
        "lost": sum(o.lost for o in found),
        "frames with an estimate": float(np.mean([o.given for o in found])),
        "mean NEES": float(np.nanmean(nees)),
        "median NEES (1.39)": float(np.nanmedian(nees)),
        "in the 95 % ellipse": float(np.mean(nees <= ELLIPSE)),
        "false bearings": false,
        "precision of those found": caught / blamed if blamed else math.nan,
        "recall": caught / false if false else math.nan,
        "frames used": sum(o.frames for o in found),
        "seconds": time.process_time() - began,
    }


def write(to: Path, method: str, settings: Mapping[str, Any], noise: Noise, seed: int, *, room: bool = False) -> None:
    """Write a scene, and each person's bearings and true places, into a folder; print everybody's RMSE."""
    folder = annotations()
    if folder is None:
        raise SystemExit("single-people: wildtrack_annotations not found")
    scene = scene_of(folder, room=room)
    to.mkdir(parents=True)
    (to / "scene.yaml").write_text(scene_to_yaml(scene), encoding="utf-8")
    for person in people(folder, scene, noise, seed):
        name, T = f"person{person.target:03d}", len(person.t_ns)
        truth = Truth.of(
            t_ns=person.t_ns,
            target_id=np.zeros(T, dtype=np.int32),
            role=["target"] * T,
            x=person.xy[:, 0],
            y=person.xy[:, 1],
            z=np.full(T, math.nan),
        )
        write_table(to / f"{name}.parquet", person.bearings, Provenance("detect"))
        write_table(to / f"{name}_truth.parquet", truth, Provenance("ingest"))
        print(f"{name} {follow(person, scene, method, settings).rmse:.4f}")


def run(repeats: int = 5) -> dict[str, Any]:
    """Median RMSE of `map` over as many seeds as repeats."""
    parts = measure("map", {}, Noise(), [FIRST_SEED + k for k in range(repeats)])
    return {"ratio": parts["median RMSE [m]"], "limit": LIMIT, "parts": parts}


def main() -> None:
    """Measure one method with its settings."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--method", default="map")
    parser.add_argument("--set", dest="settings", action="append", default=[], metavar="NAME=VALUE")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1])
    parser.add_argument("--px", type=float, default=Noise().px)
    parser.add_argument("--miss", type=float, default=Noise().miss)
    parser.add_argument("--false", type=float, default=Noise().false)
    parser.add_argument("--sigma", choices=("box", "px"), default=Noise().sigma)
    parser.add_argument("--room", action="store_true", help="where people can be is known")
    parser.add_argument("--write", type=Path, metavar="FOLDER", help="write files for the command line instead")
    parser.add_argument("--select", help="policy of the selection of cameras", default=None)
    parser.add_argument("--count", type=int, default=SelectConfig().n_cameras)
    parser.add_argument("--every", type=float, default=SelectConfig().selection_interval)
    parser.add_argument("--patience", type=int, default=SelectConfig().max_blind_scans)
    options = parser.parse_args()
    settings = dict(text.split("=", 1) for text in options.settings)
    chosen = {"count": options.count, "every": options.every, "patience": options.patience}
    selection = None if options.select is None else SelectConfig(options.select, **chosen)
    noise = Noise(options.px, options.miss, options.false, options.sigma)
    if options.write is not None:
        write(options.write, options.method, settings, noise, options.seeds[0], room=options.room)
        return
    found = measure(options.method, settings, noise, options.seeds, room=options.room, selection=selection)
    for name, value in found.items():
        print(f"{name:<28} {value:.4g}" if isinstance(value, float) else f"{name:<28} {value}")


if __name__ == "__main__":
    main()
