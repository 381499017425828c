"""Real boxes of four cameras, one left out: the share of its boxes that are predicted from the others'.

    python -m benchmarks.track.left_out [--sets CMC1,CMC2,CMC4] [--set NAME=VALUE ...]

`jipda` follows everybody without the camera (`occlog track --method jipda --without`), and `occlog evaluate --held-out`
says how many of its boxes it predicts, one to one within 100 px; beside it groups of the other cameras' boxes that are
triangulated frame by frame (`_left_out`), paired with the same boxes by the same rule.  The detections are not shipped;
`OCCLOG_SHARED_DATA` names the folder that holds `cmc_detections`.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.images._views_cases import occlog
from benchmarks.track._left_out import groups, projected
from occlog.array_types import Floats
from occlog.core.metrics.errors import pair_within

NAME = "left-out"
SUMMARY = "CMC1, 2 and 4: share of a left-out camera's boxes that triangulated groups predict, to that of jipda"
LIMIT = 1.0
SETS = ("CMC1", "CMC2", "CMC4")
CAMERAS = (1, 2, 3, 4)
GATE_PX = 100.0
FPS, SIZE = 10.0, "1920x1024"
ROOT = Path(__file__).resolve().parents[2]


def detections() -> Path | None:
    """The folder of the detections; None where it is missing."""
    path = Path(os.environ.get("OCCLOG_SHARED_DATA", ROOT.parent / "shared" / "data")) / "cmc_detections"
    return path if path.is_dir() else None


def by_triangulation(boxes: Floats, matrices: dict[int, Floats], out: int) -> dict[str, float]:
    """Share of a camera's boxes predicted by groups of the others', and the median distance [px]."""
    away: list[float] = []
    total = expected = 0
    for frame in np.unique(boxes[:, 0]):
        now = boxes[boxes[:, 0] == frame]
        middles = {c: 0.5 * (now[now[:, 1] == c, 2:4] + now[now[:, 1] == c, 4:6]) for c in CAMERAS}
        own = middles.pop(out)
        positions = groups(middles, matrices)
        pixels = np.array([projected(matrices[out], position) for position in positions]).reshape(-1, 2)
        inside = ((pixels >= 0.0) & (pixels < [1920.0, 1024.0])).all(axis=1)
        distance = np.linalg.norm(own[:, None] - pixels[None, inside], axis=2)
        away += [float(distance[i, j]) for i, j in pair_within(distance, GATE_PX)]
        total, expected = total + len(own), expected + int(inside.sum())
    return {"share": len(away) / total, "precision": len(away) / max(expected, 1), "px": float(np.median(away))}


def by_tracks(recording: Path, out: int, settings: list[str], work: Path) -> dict[str, float]:
    """The same of tracks that are made without the camera."""
    tracks = work / "tracks.parquet"
    given = [text for setting in settings for text in ("--set", setting)]
    occlog("track", recording, "--method", "jipda", "--without", f"cam{out}", *given, "-o", tracks, "--overwrite", "-q")
    asked = ["evaluate", tracks, "--views", recording, "--held-out", f"cam{out}", "--json", "-q"]
    done = subprocess.run([sys.executable, "-m", "occlog", *asked], check=True, capture_output=True, text=True)
    got = json.loads(done.stdout)
    names = {"share": "share", "precision": "precision", "px": "median_px", "chance": "share_chance"}
    return {name: got[f"held_out_boxes_{key}"] for name, key in names.items()}


def measured(sets: list[str], settings: list[str]) -> dict[str, dict[str, dict[str, float]]]:
    """Figures of both, by set and camera."""
    folder = detections()
    if folder is None:
        raise SystemExit("left-out: cmc_detections not found; set OCCLOG_SHARED_DATA to the folder it is in")
    matrices = {c: np.loadtxt(folder / "calibration" / f"cam{c}_P.txt") for c in CAMERAS}
    out = {}
    with tempfile.TemporaryDirectory() as scratch:
        work = Path(scratch)
        for name in sets:
            path = folder / f"{name}_detections.csv"
            with path.open(newline="") as file:
                rows = [
                    [float(r[k]) for k in ("frame", "camera", "left", "top", "right", "bottom")]
                    for r in csv.DictReader(file)
                ]
            recording = work / f"{name}.mcap"
            calibration = ("--calibration", folder / "calibration", "--image-size", SIZE)
            occlog("ingest", "-o", recording, *calibration, "--boxes", path, "--fps", f"{FPS:g}", "-q")
            for camera in CAMERAS:
                out[f"{name} cam{camera}"] = {
                    "triangulation": by_triangulation(np.array(rows), matrices, camera),
                    "jipda": by_tracks(recording, camera, settings, work),
                }
    return out


def run(repeats: int = 5) -> dict[str, Any]:
    """Mean share predicted by triangulation to that by jipda; nothing in it is random."""
    del repeats
    found = measured(list(SETS), [])
    shares = {n: float(np.mean([row[n]["share"] for row in found.values()])) for n in ("triangulation", "jipda")}
    return {"ratio": shares["triangulation"] / shares["jipda"], "limit": LIMIT, "parts": shares}


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.track.left_out",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--sets", default=",".join(SETS))
    parser.add_argument("--set", dest="settings", action="append", default=[], metavar="NAME=VALUE")
    options = parser.parse_args()
    print("| left out | triangulation: predicted | px | precision | jipda: predicted | by chance | px | precision |")
    print("|---|---|---|---|---|---|---|---|")
    for name, row in measured(options.sets.split(","), options.settings).items():
        a, b = row["triangulation"], row["jipda"]
        cells = (a["share"], a["px"], a["precision"], b["share"], b["chance"], b["px"], b["precision"])
        print(f"| {name} | {' | '.join(f'{v:.3f}' if v <= 1 else f'{v:.1f}' for v in cells)} |")


if __name__ == "__main__":
    main()
