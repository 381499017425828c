"""Tags by virtual sensors and by strength on six real runs, each with path losses that were learned from the others.

The data set: `ble_rssi_positions` (Danis et al. 2022): 12 readers, one tag that is carried about, its true positions.
It has no cameras: two are simulated, in the middle of the left and of the bottom wall, each with a bearing without a
label of the tag 5 times a second, with a standard deviation of 1 degree.
"""

from __future__ import annotations

import json
import math
import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from occlog.array_types import NS
from occlog.cli.main import run as occlog
from occlog.core.numerics.interpolate import interpolate_positions
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import TableWriter
from occlog.io.open import open_input
from occlog.records.tables import Bearings, Truth

NAME = "tags"
SUMMARY = "median error of rssi over that of virtual, six real runs, path losses of the other five"
DATA = Path(os.environ.get("OCCLOG_SHARED_DATA", "../shared/data")) / "ble_rssi_positions"
CAMERAS = {"left": (-0.5, 8.8, 0.0), "bottom": (10.1, -0.5, 90.0)}
"""Places and yaws [deg]."""
SIGMA, FRAME_S = math.radians(1.0), 0.2
ROOM = "\n".join(
    [
        "occlog_scene: 1",
        "room: [[-0.5, -0.5], [20.7, -0.5], [20.7, 18.1], [-0.5, 18.1]]",
        "cameras:",
        *(
            f"- {{name: {name}, position: [{x}, {y}], yaw_deg: {yaw}, focal_px: 500, fov_deg: 178}}"
            for name, (x, y, yaw) in CAMERAS.items()
        ),
        "",
    ]
)
SEEDS = 5
"""Seeds of the particles; figures are means over them."""
SHOWN = ("error_median_m", "rmse_m", "nees_mean")
SLOW = ("--set", "sigma_velocity=0.5")
"""The tag was carried slower than people walk."""
REFINED = {"": [], " + 1 camera": ["--refine", "left"], " + 2 cameras": ["--refine", "left,bottom"]}
"""Options by how positions are refined."""


def run(repeats: int) -> dict[str, Any]:  # noqa: ARG001
    """Median and RMS error [m] and mean NEES of each method and run; the ratio is that of the mean medians."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        runs = ingest_all(folder)
        parts: dict[str, float] = {}
        means = {"virtual": 0.0, "rssi": 0.0}
        for name in runs:
            _simulate_cameras(folder / f"{name}.mcap", folder / f"{name}.sights.parquet")
        for held in runs:
            loss = folder / f"{held}.json"
            others = [str(folder / f"{other}.mcap") for other in runs if other != held]
            _do(["fit-readers", *others, "-o", str(loss)])
            for method, seeds in (("virtual", 1), ("rssi", SEEDS)):
                for words, options in REFINED.items():
                    found = [_errors(folder, held, method, loss, seed, options) for seed in range(seeds)]
                    for figure in SHOWN:
                        parts[f"{held} {method}{words} {figure}"] = sum(f[figure] for f in found) / seeds
                means[method] += parts[f"{held} {method} error_median_m"] / len(runs)
    return {"ratio": means["rssi"] / means["virtual"], "parts": parts}


def ingest_all(folder: Path) -> list[str]:
    """Make a recording of each run; return the names of the runs."""
    (folder / "scene.yaml").write_text(ROOM)
    text = (DATA / "cnf" / "tetam.dev").read_text()
    devices = json.loads(text.split("Dongles:")[1].splitlines()[0])
    rows = [",".join([name, *map(str, values[0])]) for name, values in devices.items()]
    (folder / "readers.csv").write_text("\n".join(["reader,x,y,z", *rows]) + "\n")
    runs = []
    for log in sorted((DATA / "trk").glob("*_all_sensors.mbd")):
        name = log.name.removesuffix("_all_sensors.mbd")
        cells = [line.split(",") for line in log.read_text().splitlines() if line]
        reads = [",".join(c[:4]) for c in cells]
        truth = {c[0]: ",".join([c[0], *c[4:7]]) for c in cells}  # reads of one time have one place
        (folder / "reads.csv").write_text("\n".join(["t,reader,tag,rssi", *reads]) + "\n")
        (folder / "truth.csv").write_text("\n".join(["t,x,y,z", *truth.values()]) + "\n")
        where = ["--scene", str(folder / "scene.yaml"), "--readers", str(folder / "readers.csv")]
        what = ["--reads", str(folder / "reads.csv"), "--truth", str(folder / "truth.csv")]
        _do(["ingest", *where, *what, "-o", str(folder / f"{name}.mcap")])
        runs.append(name)
    return runs


def _simulate_cameras(recording: Path, output: Path) -> None:
    """Write bearings of the cameras of the recording's scene to its true target."""
    opened = open_input(recording, Truth)
    truth = opened.read(Truth)
    t_ns = np.arange(truth.t_ns[0], truth.t_ns[-1], round(FRAME_S * NS))
    xy, _ = interpolate_positions(t_ns, truth.t_ns, np.column_stack([truth.x, truth.y]), 10 * NS)
    rng = np.random.default_rng(0)
    parts = []
    for name, (x, y, _) in CAMERAS.items():
        bearing = np.arctan2(xy[:, 1] - y, xy[:, 0] - x) + SIGMA * rng.standard_normal(len(t_ns))
        n, nothing = len(t_ns), np.full(len(t_ns), np.nan)
        parts.append(
            Bearings.of(
                t_ns=t_ns,
                sensor=np.full(n, name),
                target_id=np.full(n, -1, dtype=np.int32),
                seen=np.ones(n, dtype=np.bool_),
                bearing=bearing,
                sigma=np.full(n, SIGMA),
                u_px=nothing,
                sigma_px=nothing,
                score=nothing,
            )
        )
    with TableWriter(output, Bearings, Provenance("simulate")) as writer:
        writer.write(Bearings.merge(parts))


def _errors(folder: Path, held: str, method: str, loss: Path, seed: int, options: list[str]) -> dict[str, float]:
    """Track one run, and return its figures."""
    tracks, figures = folder / "tracks.parquet", folder / "figures.json"
    recording = str(folder / f"{held}.mcap")
    how = ["--method", method, "--path-loss", str(loss), "--seed", str(seed), "--overwrite", *options]
    how += SLOW if method == "rssi" else ()
    if options:
        how += ["--refine-bearings", str(folder / f"{held}.sights.parquet")]
    _do(["track", recording, "-o", str(tracks), *how])
    _do(["evaluate", str(tracks), "--truth", recording, "--max-gap", "2", "-o", str(figures), "--overwrite"])
    found: dict[str, float] = json.loads(figures.read_text())
    return found


def _do(args: list[str]) -> None:
    """Run a command of the program, without its summary."""
    shown = os.dup(1)
    with Path(os.devnull).open("w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
        try:
            code = occlog([*args, "--quiet"])
        finally:
            os.dup2(shown, 1)
            os.close(shown)
    if code:
        raise SystemExit(f"occlog {' '.join(args)}: exit code {code}")
