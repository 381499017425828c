"""How small errors of smoothed tracks can be on the boxes of WILDTRACK: the smoother when it is told who is whose.

    python -m benchmarks.track.smoothing_bound [--settings ABC] [--seeds 0-2] [--work DIR]

For each setting the RMSE on the ground of pairs within 1 m:

* `filter`, `--smooth`: `occlog track --method jipda` on the boxes.
* `--smooth`, boxes told: its smoother with the boxes of each person, no other boxes, and linearised at the true places;
  after that at its own.
* `spline, boxes told`: cubic smoothing splines through the places that each moment's boxes give of a person alone
  (least squares with the smoother's weights), all with the one stiffness and the one scatter of places that make the
  error smallest, by the truth.
* `spline, each its own`: those that make the error of each person smallest, by the truth.
* `moments alone`: these places without any smoothing.

The last four know what no tracker knows.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from benchmarks.peers.views_peer import seeds
from benchmarks.track._crowd_cases import Case, wildtrack
from benchmarks.track._crowd_trackers import Outcome, recorded
from benchmarks.track._single_people import annotations
from benchmarks.track.crowd import cell, scored
from occlog.array_types import NS, Floats, Ints
from occlog.core.numerics.seeds import RandomStream, generator
from occlog.track.methods.jipda.association_features import feature_likelihood
from occlog.track.methods.jipda.batch import smooth as smoother
from occlog.track.methods.jipda.batch.association import (
    AssociatedBoxes,
    AssociatedPeople,
    PredictedPeople,
    assign_boxes,
)
from occlog.track.methods.jipda.batch.mcmc_association import NO_NODE
from occlog.track.methods.jipda.batch.tracks import tracks_from
from occlog.track.methods.jipda.filter import JipdaState, initial_state, step
from occlog.track.methods.jipda.interface import HEIGHT, WIDTH, FrameDetections, TrackSnapshot
from occlog.track.methods.jipda.kernels.detections import DetectorModel, PackedDetections
from occlog.track.people.inputs import PeopleInput
from occlog.track.request import TrackPeopleRequest

SURE = 0.999
SPREAD_M = 0.05
"""Standard deviation of the people who hide one another."""
FAR = 6.0
"""A box is a person's if its edges are this near to those of the person's true box [standard deviations], at most."""
PX = {"A": 5.0, "B": 8.0, "C": 5.0}
"""Standard deviation of the edges in each setting."""
PASSES = 3
"""Of the smoother; the boxes are linearised anew at its places in each."""
STIFF = np.geomspace(1.0, 1e4, 17)
"""Weights of squared second differences [1/m^2] that are tried, ..."""
SCATTER_M = (0.0, 0.03, 0.05, 0.07, 0.1, 0.15)
"""... and standard deviations of places about the walk that boxes do not tell of [m]."""
NEAR_M = 1.0


class Run(NamedTuple):
    """The filter's run over a case, and what it is told here."""

    state: JipdaState
    looks: list[list[FrameDetections]]
    moments: list[TrackSnapshot]
    whose: list[Ints]  # of the boxes of each moment; NONE: nobody's


def run_of(case: Case, recording: Path, px: float) -> Run:
    """Run the filter, and find out whose each box is."""
    request = TrackPeopleRequest(
        bearings=recording, output=recording.with_name("tracks.parquet"), method="jipda", settings={"smooth": True}
    )
    inputs = PeopleInput(request)
    folder = annotations()
    assert folder is not None
    true = np.loadtxt(folder / "boxes_true.csv", delimiter=",", skiprows=1)
    state, looks, snapshots, owner = initial_state(inputs.scene, inputs.cameras, inputs.config), [], [], []
    for group in inputs.time_steps:
        looks.append([each.detections for each in group])
        state, snapshot = step(state, looks[-1])
        snapshots.append(snapshot)
        own = []
        for each in group:
            here = true[(true[:, 0] == each.frame) & (true[:, 1] == each.detections.camera + 1)]
            own.append(_whose(each.detections.boxes, here, px, case.size))
        owner.append(np.concatenate(own))
    return Run(state, looks, snapshots, owner)


def _whose(boxes: Floats, true: Floats, px: float, size: tuple[int, int]) -> Ints:
    """(n,) person of each box, the nearest one to one; NONE."""
    out = np.full(len(boxes), NO_NODE)
    if not len(boxes) or not len(true):
        return out
    high = np.array([*size, *size]) - 1.0
    apart = np.linalg.norm(np.clip(boxes, 0, high)[:, None] - np.clip(true[:, 2:6], 0, high), axis=2) / px
    rows, columns = linear_sum_assignment(np.minimum(apart, 2 * FAR))
    good = apart[rows, columns] < FAR
    out[rows[good]] = true[columns[good], 6].astype(np.int64)
    return out


def told(run: Run, case: Case) -> tuple[Outcome, list[AssociatedPeople]]:
    """The smoother's tracks with the boxes of each person, and what the boxes of each moment say."""
    state, snapshots = run.state, run.moments
    packed = [smoother._scored(state, g, m.t_ns) for g, m in zip(run.looks, snapshots, strict=True)]
    span = smoother.span_of(state, packed, snapshots)
    rates = smoother._rates(state, span)
    c = state.config
    frames = [round(m.t_ns / NS * case.fps) for m in snapshots]
    place = {(int(f), int(k)): (x, y) for f, k, x, y in case.truth}
    states: dict[tuple[int, int], Floats] = {}
    for (f, k), (x, y) in place.items():
        states[f, k] = np.array([x, y, 0.0, 0.0, c.person_height, c.person_width])
    square = (smoother.INITIAL_SCALE_M * state.metre) ** 2
    law = feature_likelihood(state.cues.similarities)
    for _ in range(PASSES):
        found = [_found(state, packed[k], rates, frames[k], run.whose[k], states) for k in range(len(snapshots))]
        own: float | Floats = square
        tracks = tracks_from(found, span, c, state.birth_map, own, free=False, law=law)
        for _ in range(smoother.REFINEMENTS):
            own, square = smoother._scattered(tracks, span, square, state.metre)
            tracks = tracks_from(found, span, c, state.birth_map, own, free=False, law=law)
        walk = smoother._states(tracks, span, 0)
        mean, covariance = smoother._with_places(walk, tracks, np.asarray(own), square, 1.0)
        label = tracks.label[walk.head]
        rows = []
        for m, k, x, P in zip(walk.step.tolist(), label.tolist(), mean, covariance, strict=True):
            states[frames[m], k] = x
            if (frames[m], k) in place:
                rows.append((frames[m], k, *x[:2], P[0, 0], P[0, 1], P[1, 1]))
    return Outcome(np.array(rows), 0.0), found


def _found(
    state: JipdaState,
    boxes: PackedDetections,
    rates: DetectorModel,
    frame: int,
    owner: Ints,
    states: dict[tuple[int, int], Floats],
) -> AssociatedPeople:
    """What the boxes of a moment say of those whose they are."""
    people = np.array([k for k in np.unique(owner[owner != NO_NODE]).tolist() if (frame, k) in states], dtype=np.int64)
    mean = np.array([states[frame, k] for k in people.tolist()]).reshape(-1, 6)
    covariance = np.broadcast_to(np.eye(6) * SPREAD_M**2, (len(people), 6, 6)).copy()
    share = np.where(owner == people[:, None], SURE, 0.0)
    # Boxes of nobody are taken, so that nobody new is made of them
    who = PredictedPeople(people, mean, covariance, np.full(len(people), SURE))
    hints = np.full((len(owner), 2), NO_NODE)
    seen = AssociatedBoxes(who, share, np.zeros_like(share), np.ones((len(boxes.camera), len(people))))
    found = assign_boxes(state, boxes, rates, hints, np.full((len(owner), 0), np.nan), seen)
    keep = found.track != NO_NODE
    return AssociatedPeople(
        *(v[:, keep] if name == "given" else v[keep] for name, v in zip(AssociatedPeople._fields, found, strict=True))
    )


def splines(run: Run, case: Case, found: Sequence[AssociatedPeople]) -> dict[str, float]:
    """Errors of splines through the places of moments."""
    frames = [round(m.t_ns / NS * case.fps) for m in run.moments]
    truth = {(int(f), int(k)): np.array([x, y]) for f, k, x, y in case.truth}
    by_person: dict[int, list[tuple[int, Floats, Floats]]] = {}
    for frame, each in zip(frames, found, strict=True):
        for k, mean, J, h in zip(each.track.tolist(), each.mean, each.J, each.h, strict=True):
            # The body is known: that of the smoothed state
            body = [HEIGHT, WIDTH]
            W = J[:2, :2]
            by_person.setdefault(k, []).append((frame, W, h[:2] - J[np.ix_([0, 1], body)] @ mean[body]))
    alone = []
    errors: list[Floats] = []
    for k, places in by_person.items():
        first, last = places[0][0], places[-1][0]
        known = np.array([f for f in range(first, last + 1) if (f, k) in truth], dtype=np.int64)
        alone += [np.linalg.pinv(W) @ v - truth[f, k] for f, W, v in places if (f, k) in truth]
        if last - first >= 2 and len(known):
            true = np.array([truth[f, k] for f in known.tolist()])
            squares = [_smoothed(places, first, last, spread)[:, known - first] - true for spread in SCATTER_M]
            errors.append(np.concatenate([np.sum(e**2, axis=2) for e in squares]))
    off = np.array(alone)
    near = (off**2).sum(axis=1) < NEAR_M**2
    # Pairs beyond 1 m count in none of the figures
    sums = np.array([[np.where(e < NEAR_M**2, e, 0.0).sum(axis=1), (e < NEAR_M**2).sum(axis=1)] for e in errors])
    total = sums.sum(axis=0)
    best = np.argmin(total[0] / total[1])
    every = np.argmin(sums[:, 0] / np.maximum(sums[:, 1], 1), axis=1)
    own = sums[np.arange(len(sums)), :, every].sum(axis=0)
    return {
        "spline, boxes told": float(np.sqrt(total[0, best] / total[1, best])),
        "spline, each its own": float(np.sqrt(own[0] / own[1])),
        "moments alone": float(np.sqrt((off[near] ** 2).sum(axis=1).mean())),
    }


def _smoothed(places: Sequence[tuple[int, Floats, Floats]], first: int, last: int, spread: float) -> Floats:
    """(S, n, 2) splines of every stiffness through places, about which the boxes are off by so much [m] besides."""
    n = last - first + 1
    A, b = np.zeros((2 * n, 2 * n)), np.zeros(2 * n)
    for frame, W, v in places:
        at = 2 * (frame - first)
        shrunk = np.linalg.inv(np.eye(2) + spread**2 * W)
        A[at : at + 2, at : at + 2] += W @ shrunk.T
        b[at : at + 2] += shrunk @ v
    second = np.kron(np.diff(np.eye(n), 2, axis=0), np.eye(2))
    bend = second.T @ second
    return np.array([np.linalg.solve(A + stiff * bend + 1e-9 * np.eye(2 * n), b).reshape(n, 2) for stiff in STIFF])


def outcome(snapshots: Sequence[TrackSnapshot], case: Case) -> Outcome:
    """Rows of a tracker."""
    rows = [
        (round(m.t_ns / NS * case.fps), k, *x[:2], P[0, 0], P[0, 1], P[1, 1])
        for m in snapshots
        for k, x, P in zip(m.ids, m.mean, m.covariance, strict=True)
    ]
    return Outcome(np.array(rows), 0.0)


def figures(case: Case, work: Path, px: float) -> dict[str, float]:
    """RMSE [m] of each."""
    run = run_of(case, recorded(case, work), px)
    smoothed = smoother.smooth(run.state, run.looks, run.moments, generator(0, RandomStream.SMOOTH))
    known, found = told(run, case)
    own = {"filter": outcome(run.moments, case), "`--smooth`": outcome(smoothed, case), "`--smooth`, boxes told": known}
    out = {name: scored(case, each)["RMSE [m]"] for name, each in own.items()}
    return out | splines(run, case, found)


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.track.smoothing_bound", description=__doc__)
    parser.add_argument("--settings", default="ABC", help="of WILDTRACK; default ABC")
    parser.add_argument("--seeds", type=seeds, default=seeds("0-2"), help="default 0-2")
    parser.add_argument("--work", type=Path, help="keep recordings there")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        work = options.work or Path(scratch)
        work.mkdir(parents=True, exist_ok=True)
        for setting in options.settings:
            rows: list[dict[str, float]] = []
            for seed in options.seeds:
                case = wildtrack(setting, seed, work)
                if case is None:
                    raise SystemExit("wildtrack_annotations and tools/crowd are not there")
                rows.append(figures(case, work, PX[setting]))
            if setting == options.settings[0]:
                print(f"| | {' | '.join(rows[0])} |\n|---|{'---|' * len(rows[0])}")
            print(f"| {setting} | {' | '.join(cell([row[k] for row in rows]) for k in rows[0])} |", flush=True)
            least = np.mean([row["filter"] for row in rows])
            print(
                f"| | {' | '.join(f'{np.mean([r[k] for r in rows]) / least - 1:+.0%}' for k in rows[0])} |", flush=True
            )


if __name__ == "__main__":
    main()
