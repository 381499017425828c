"""Trackers of everybody, given the same boxes: the evening's baseline, those of other projects, and occlog's.

Stone Soup tracks the places that the baseline fuses, norfair and roboflow's `trackers` the boxes of each camera, which
the baseline then takes for those of a detector.  They run in environments of their own: those that
OCCLOG_CROWD_PEERS names (a folder with stonesoup/bin/python and so on), or such as are made for the run.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.images._views_cases import occlog
from benchmarks.peers._environments import environment, output_of
from benchmarks.track import _crowd_baseline as baseline
from benchmarks.track._crowd_cases import Case, room, write
from occlog.array_types import NS, Floats
from occlog.errors import ExitCode
from occlog.io.files.tables.parquet import read_table
from occlog.records.tables import Tracks

VARIABLE = "OCCLOG_CROWD_PEERS"
PACKAGES = {
    "stonesoup": ("stonesoup==1.9.1", "pyehm==2.2"),
    "norfair": ("norfair==2.3.0",),
    "trackers": ("trackers==2.6.1",),
}
DETECTION, CLUTTER = 0.9, 2.0
"""What Stone Soup's JPDA is told: probability that a person has a fused place, false places a frame."""


class Outcome(NamedTuple):
    """Tracks and the processor time that they took."""

    rows: Floats  # (N, 7) frame, identity, x, y [m], covariance xx, xy, yy [m^2], NaN where there is none
    seconds: float
    megabytes: float = math.nan  # largest memory of the program, where it is one of its own


Tracker = Callable[[Case, Path], Outcome]


def evening(case: Case, work: Path) -> Outcome:
    """The baseline."""
    del work  # it needs no files
    began = time.process_time()
    rows = baseline.followed(baseline.fused(case), case)
    return Outcome(rows, time.process_time() - began)


def floor_peer(name: str) -> Tracker:
    """Stone Soup on the baseline's fused places; the time is that of both."""

    def run(case: Case, work: Path) -> Outcome:
        began = time.process_time()
        points = baseline.fused(case)
        fusion = time.process_time() - began
        x0, x1, y0, y1 = case.area
        np.savez(
            work / "given.npz",
            points=points,
            frames=case.frames,
            fps=case.fps,
            area=(x1 - x0) * (y1 - y0),
            density=baseline.DENSITY,
            place_sd=baseline.PLACE_SD,
            speed=baseline.SPEED,
            gate=baseline.GATE,
            miss_s=baseline.MISS_S,
            hits=baseline.HITS,
            detection=DETECTION,
            clutter=CLUTTER,
        )
        python = _python("stonesoup", work)
        seconds = output_of(python, "_floor_peer.py", work / "given.npz", work / "out.npz", name)["seconds"]
        return Outcome(np.load(work / "out.npz")["rows"], fusion + seconds)

    return run


def view_peer(name: str, package: str) -> Tracker:
    """A tracker of boxes for each camera, whose boxes go to the floor as the baseline's do."""

    def run(case: Case, work: Path) -> Outcome:
        cameras = len(case.matrices)
        boxes = case.boxes[np.lexsort((case.boxes[:, 0], case.boxes[:, 1]))]
        placed = np.column_stack([boxes[:, 2:4], boxes[:, 4:6] - boxes[:, 2:4]])
        np.savez(
            work / "given.npz",
            frames=np.full(cameras, case.frames),
            fps=case.fps,
            view=boxes[:, 1].astype(np.int64),
            frame=boxes[:, 0].astype(np.int64),
            box=placed,
        )
        python = _python(package, work)
        seconds = output_of(python, "_views_peer.py", work / "given.npz", work / "out.npz", name)["seconds"]
        got = np.load(work / "out.npz")
        corners = np.column_stack([got["box"][:, :2], got["box"][:, :2] + got["box"][:, 2:]])
        smoothed = case._replace(boxes=np.column_stack([got["frame"], got["view"], corners]))
        made = evening(smoothed, work)
        return Outcome(made.rows, seconds + made.seconds)

    return run


def ours(*arguments: str) -> Tracker:
    """`occlog track --method jipda`; the time is that of the command without that of its start."""

    def run(case: Case, work: Path) -> Outcome:
        recording = recorded(case, work)
        out = work / "tracks.parquet"
        given = ("--method", "jipda", *arguments, "-o", out, "--overwrite", "-q")
        before = start(*arguments)  # compiles what is not compiled yet
        seconds, megabytes = timed("track", recording, *given)
        seconds -= before
        t = read_table(out, Tracks)
        frame = np.rint(t.t_ns * case.fps / NS)
        rows = np.column_stack([frame, t.target_id, t.x, t.y, t.cov_xx, t.cov_xy, t.cov_yy])
        return Outcome(rows, seconds, megabytes)

    return run


@cache
def start(*arguments: str) -> float:
    """Processor time [s] of the command on ten frames with two people: compiled code is loaded, not compiled."""
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        recording = recorded(room(2, 4, 0, 10, 10.0), work)
        given = ("track", recording, "--method", "jipda", *arguments, "-o", work / "t.parquet", "--overwrite", "-q")
        timed(*given)
        return min(timed(*given)[0] for _ in range(2))


def timed(*arguments: str | Path) -> tuple[float, float]:
    """Processor time [s] and largest memory [MB] of a command; what it lists as lost is no error."""
    with tempfile.TemporaryFile() as reported:
        child = subprocess.Popen(
            [sys.executable, "-m", "occlog", *map(str, arguments)], stdout=reported, stderr=reported
        )
        _, status, used = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        reported.seek(0)
        if child.returncode not in (ExitCode.DONE, ExitCode.LOSSY):
            raise SystemExit(f"occlog {' '.join(map(str, arguments))}: {reported.read().decode(errors='replace')}")
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


def recorded(case: Case, work: Path) -> Path:
    """The boxes with the calibration as a recording."""
    recording = work / "boxes.mcap"
    write(case, work)
    size = "x".join(map(str, case.size))
    given = ("--calibration", work / "calibration", "--calibration-format", "projection", "--image-size", size)
    frames = ("--fps", f"{case.fps:g}", "--frames", f"0:{case.frames}")
    occlog("ingest", "-o", recording, *given, "--boxes", work / "boxes.csv", *frames, "--overwrite", "-q")
    return recording


TRACKERS: dict[str, Tracker] = {
    "baseline": evening,
    "stonesoup-gnn": floor_peer("gnn"),
    "stonesoup-jpda": floor_peer("jpda"),
    "norfair": view_peer("norfair-quick", "norfair"),
    "ocsort": view_peer("ocsort", "trackers"),
    "jipda": ours(),
    "jipda, all alike": ours("--set", "use_visibility=false"),
    "jipda, smoothed": ours("--smooth"),
}
"""Every tracker by its name in the table."""


def _python(package: str, work: Path) -> Path:
    home = Path(os.environ.get(VARIABLE) or work / "peers") / package
    return environment(home, *PACKAGES[package])
