"""Tracking in images against trackers of other projects, from the same regions.

    python -m benchmarks.peers.views_peer [--pets FOLDER] [--seeds 1-3] [--only A,B,...] [--work DIR] [--json]

FOLDER holds PETS 2009 S2.L1 view 1 (`vtest.avi`, `calibration`, `annotations`; it is not shipped).  Without it
only the simulated room is tracked: people who look alike in three views, a recording for each seed.

Every tracker gets the regions of `occlog detect` with its default settings; `(true start)` gets the first true
ellipse of each target instead.  norfair and roboflow's `trackers` see boxes only, one view at a time, and run
in environments of their own: those that OCCLOG_VIEW_PEERS names (a folder with norfair/bin/python and
trackers/bin/python), or else such as are made for the run.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.images import _views_cases as cases
from benchmarks.images._views_cases import Case
from benchmarks.images._views_score import FIGURES, LabelledBoxes, around, figures, inside
from benchmarks.peers._environments import environment, output_of
from occlog.io.files.tables.parquet import read_table
from occlog.records.declared.views import ViewTracks
from occlog.records.tables import Views

VARIABLE = "OCCLOG_VIEW_PEERS"
PACKAGES = {"norfair": "norfair==2.3.0", "trackers": "trackers==2.6.1"}
PEERS = {
    "norfair": "norfair",
    "norfair-quick": "norfair",
    "bytetrack": "trackers",
    "ocsort": "trackers",
    "sort": "trackers",
}
OURS = ("mipf", "idmot", "cmct", "bmct")
TRUE_STARTS = ("idmot", "bmct")
ALONE = ("mipf", "idmot", "bmct")
"""Methods that are something with one view."""
TRUE_START = " (true start)"
EVERYBODY: dict[str, tuple[str, ...]] = {"jipda": (), "jipda --smooth": ("--smooth",)}
"""Options of `--method jipda`, which knows where the cameras are and does not look at pixels."""
EVERY = (*OURS, *EVERYBODY, *PEERS, *(m + TRUE_START for m in TRUE_STARTS))


class Outcome(NamedTuple):
    """Tracks, and the processor time they took."""

    tracks: LabelledBoxes
    seconds: float
    joint: bool  # labels are the same in all views


def save(path: Path, case: Case) -> None:
    """Write the boxes of all views for a tracker of boxes."""
    found = read_table(case.detections, Views)
    np.savez(
        path,
        frames=case.frames,
        fps=case.fps,
        view=cases.places(found.sensor, case.views),
        frame=found.frame,
        box=cases.columns(found),
    )


def theirs(case: Case, name: str, python: Path, work: Path) -> Outcome:
    """Tracks of another project."""
    given, out = work / "given.npz", work / "tracks.npz"
    save(given, case)
    seconds = output_of(python, "_views_peer.py", given, out, name)["seconds"]
    got = np.load(out)
    return Outcome(LabelledBoxes._make(got[column] for column in LabelledBoxes._fields), seconds, joint=False)


def ours(case: Case, method: str, work: Path, *, true_start: bool) -> Outcome:
    """Tracks of `occlog track`; the time is that of the whole command, which decodes the video."""
    out = work / "view_tracks.parquet"
    start = ("--initial-ellipses", case.recording) if true_start else ("--detections", case.detections)
    seconds = cases.occlog("track", case.recording, "--method", method, *start, "-o", out, "--overwrite", "-q")
    return _placed(case, out, seconds)


def people_tracks(case: Case, options: tuple[str, ...], work: Path) -> Outcome:
    """Tracks of `--method jipda` in the images."""
    given, out = ("--scene", case.recording, "--method", "jipda", *options), work / "everybody.parquet"
    outputs = ("-o", work / "tracks.parquet", "--view-tracks", out, "--overwrite", "-q")
    return _placed(case, out, cases.occlog("track", case.detections, *given, *outputs))


def _placed(case: Case, out: Path, seconds: float) -> Outcome:
    """The tracks of a file."""
    t = read_table(out, ViewTracks)
    ellipses = np.column_stack([t.x_px, t.y_px, t.a_px, t.b_px, t.rho])
    placed = LabelledBoxes(cases.places(t.sensor, case.views), t.frame, t.target_id.astype(np.int64), around(ellipses))
    return Outcome(placed, seconds, joint=len(case.views) > 1)


def scored(case: Case, outcome: Outcome) -> dict[str, float]:
    """Figures over the frames with truth; boxes wholly outside the image do not count."""
    t = outcome.tracks
    kept = LabelledBoxes._make(column[t.frame < case.last] for column in t)
    size = np.array(case.sizes)[kept.view]
    out = figures(case.truth, inside(kept, size)) | {"fps": sum(case.frames) / outcome.seconds}
    if not outcome.joint:
        out["fr_l joint"] = np.nan
    return out


def contenders(views: int, only: list[str], folder: Path) -> Iterator[tuple[str, Callable[[Case, Path], Outcome]]]:
    """Trackers by name, those asked for."""
    methods = [m for m in (OURS if views > 1 else ALONE) if m in only]
    for method in methods:
        yield method, lambda c, w, m=method: ours(c, m, w, true_start=False)  # type: ignore[misc]
    for name in (n for n in EVERYBODY if n in only):
        yield name, lambda c, w, o=EVERYBODY[name]: people_tracks(c, o, w)  # type: ignore[misc]
    for name in (n for n in PEERS if n in only):
        package = PEERS[name]
        home = Path(os.environ.get(VARIABLE) or folder) / package
        python = environment(home, PACKAGES[package])
        yield name, lambda c, w, n=name, p=python: theirs(c, n, p, w)  # type: ignore[misc]
    for method in (m for m in TRUE_STARTS if m + TRUE_START in only):
        yield method + TRUE_START, lambda c, w, m=method: ours(c, m, w, true_start=True)  # type: ignore[misc]


def compare(given: list[Case], only: list[str], folder: Path, work: Path) -> dict[str, dict[str, list[float]]]:
    """Figures of all trackers, a value for each case."""
    out: dict[str, dict[str, list[float]]] = {}
    for name, run in contenders(len(given[0].views), only, folder):
        rows = [scored(case, run(case, work)) for case in given]
        out[name] = {figure: [row[figure] for row in rows] for figure in (*FIGURES, "fps")}
        print(f"{name}: done", file=sys.stderr)
    return out


def cell(figure: str, values: list[float]) -> str:
    """Mean and standard error for a person."""
    if np.isnan(values).any():
        return "–"
    mean, digits = float(np.mean(values)), 0 if figure in ("fps", "switches") else 3
    if len(values) < 2 or figure == "fps":
        return f"{mean:.{digits}f}"
    return f"{mean:.{digits}f} ± {np.std(values, ddof=1) / np.sqrt(len(values)):.{digits}f}"


def show(title: str, found: dict[str, dict[str, list[float]]]) -> None:
    """A table in Markdown."""
    names = (*FIGURES, "fps")
    print(f"\n{title}\n\n| tracker | {' | '.join(names)} |\n|---|{'---|' * len(names)}")
    for tracker, got in found.items():
        print(f"| {tracker} | {' | '.join(cell(name, got[name]) for name in names)} |")


def seeds(text: str) -> list[int]:
    """The numbers of `1-5` or `1,4,7`; none of an empty text."""
    if not text:
        return []
    first, _, last = text.partition("-")
    return list(range(int(first), int(last) + 1)) if last else [int(part) for part in text.split(",")]


def main() -> None:
    """Run all trackers on all cases."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.peers.views_peer",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--pets", type=Path, metavar="FOLDER", help="real video with true boxes")
    parser.add_argument("--seeds", type=seeds, default=seeds("1-3"), help="of the simulated room; default 1-3")
    parser.add_argument("--only", metavar="A,B,...", help=f"these trackers; of {', '.join(EVERY)}")
    parser.add_argument("--work", type=Path, help="keep recordings and environments here")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    options = parser.parse_args()
    only = options.only.split(",") if options.only else list(EVERY)
    results: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as scratch:
        work = options.work or Path(scratch)
        work.mkdir(parents=True, exist_ok=True)
        if options.pets:
            results["PETS, one view"] = compare([cases.pets(options.pets, work)], only, work, Path(scratch))
        if options.seeds:
            rooms = [cases.room(seed, work) for seed in options.seeds]
            results["room, three views"] = compare(rooms, only, work, Path(scratch))
    if options.json:
        print(json.dumps(results, sort_keys=True))
        return
    for title, found in results.items():
        show(title, found)


if __name__ == "__main__":
    main()
