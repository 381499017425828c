"""What colours are worth to the tracks of everybody: a simulated room whose cameras lose people.

People walk about in a room of 10 x 8 m, 5 frames a second for 30 s; two cameras do not see all of it, and not whom
others hide.  `python -m benchmarks.track.crowd_colours` prints a line for each number of people: the
filter and the smoothed tracks, with colours of boxes and without, on the same boxes.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np

from benchmarks.references import scene
from benchmarks.track._crowd_cases import Case
from benchmarks.track._crowd_trackers import Outcome
from benchmarks.track.crowd import scored
from occlog.array_types import NS
from occlog.track.methods.jipda.batch.smooth import smooth
from occlog.track.methods.jipda.config import JipdaConfig
from occlog.track.methods.jipda.filter import initial_state, step
from occlog.track.methods.jipda.interface import TrackSnapshot

NAME = "crowd-colours"
SUMMARY = "Tracks of everybody with and without colours, where cameras lose people for a while"
CAMERAS, HZ, FRAMES, COLOURS = 2, 5.0, 150, 16
SIZE = (10.0, 8.0)
SHOWN = ("IDF1", "MOTA", "switches", "RMSE [m]", "NEES")


def one(people: int, seed: int, colours: int) -> dict[str, dict[str, float]]:
    """Figures of the filter and of the smoothed tracks."""
    made = scene("crowds").crowd(people, CAMERAS, FRAMES, HZ, SIZE, seed=seed, colours=colours)
    state, snapshots = initial_state(made.scene, made.scene.cameras, JipdaConfig.in_unit("m")), []
    for frames_of_step in made.moments:
        state, snapshot = step(state, frames_of_step)
        snapshots.append(snapshot)
    frame, person = (a.ravel() for a in np.meshgrid(range(FRAMES), range(people), indexing="ij"))
    truth = np.column_stack([frame, person, made.truth.reshape(-1, 2)])
    none = np.zeros((0, 0))
    case = Case("colours", HZ, (1280, 720), none, none, truth, (0.0, SIZE[0], 0.0, SIZE[1]), FRAMES)
    smoothed = smooth(state, made.moments, snapshots, np.random.default_rng(0))
    return {name: scored(case, _rows(found)) for name, found in (("filter", snapshots), ("smoothed", smoothed))}


def _rows(snapshots: Sequence[TrackSnapshot]) -> Outcome:
    """What a benchmark scores of them."""
    rows = [
        (round(m.t_ns / NS * HZ), identity, *mean[:2], P[0, 0], P[0, 1], P[1, 1])
        for m in snapshots
        for identity, mean, P in zip(m.ids, m.mean, m.covariance, strict=True)
    ]
    return Outcome(np.array(rows).reshape(-1, 7), 0.0)


def main(argv: Sequence[str] | None = None) -> int:
    """Print means over the seeds with standard errors."""
    parser = argparse.ArgumentParser(description=SUMMARY)
    parser.add_argument("--people", default="6,12", help="numbers of people, joined by commas")
    parser.add_argument("--seeds", default="0-3", help="first and last seed")
    options = parser.parse_args(argv)
    first, last = (int(s) for s in options.seeds.split("-"))
    for people in (int(n) for n in options.people.split(",")):
        for colours in (0, COLOURS):
            runs = [one(people, seed, colours) for seed in range(first, last + 1)]
            for name in runs[0]:
                values = {key: np.array([run[name][key] for run in runs]) for key in SHOWN if key in runs[0][name]}
                reported = " / ".join(
                    f"{key} {v.mean():.3f} ± {v.std(ddof=1) / len(v) ** 0.5:.3f}" for key, v in values.items()
                )
                print(f"{people} people, {name}, {'colours' if colours else 'no colours'}: {reported}", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
