"""Peak memory of the commands that read whole tables, on tables of rising length."""

from __future__ import annotations

import multiprocessing
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from occlog.io.files.parquet import TableWriter
from occlog.io.files.provenance import Provenance
from occlog.records.tables import Tracks, Truth

NAME = "large"
SUMMARY = "peak memory of evaluate, report, diff, export and info: ten times as many rows to fewer"
LIMIT = 1.25
ROWS = int(os.environ.get("OCCLOG_BENCHMARK_ROWS", "400000"))
"""Rows of the shorter tables; more than are drawn whole by `report`."""
STEP_NS, CHUNK = 10**8, 50_000


def make(folder: Path, rows: int) -> None:
    """A track and its truth of so many rows, and the errors that `evaluate` finds."""
    folder.mkdir()
    made = Provenance("track")
    with (
        TableWriter(folder / "tracks.parquet", Tracks, made) as tracks,
        TableWriter(folder / "truth.parquet", Truth, made) as truth,
    ):
        for start in range(0, rows, CHUNK):
            step = np.arange(start, min(start + CHUNK, rows))
            n, error = len(step), np.random.default_rng(start).normal(0.0, 0.1, (2, len(step)))
            x, y = 4.0 * np.cos(0.02 * step), 4.0 * np.sin(0.022 * step)
            shared = {"t_ns": step * STEP_NS, "target_id": np.zeros(n, np.int32)}
            truth.write(Truth.of(**shared, role=np.full(n, "target"), x=x, y=y, z=np.zeros(n)))
            spread = {"cov_xx": np.full(n, 0.01), "cov_xy": np.zeros(n), "cov_yy": np.full(n, 0.01)}
            tracks.write(Tracks.of(**shared, x=x + error[0], y=y + error[1], vx=error[0], vy=error[1], **spread))


def peak_mb(*args: str) -> float:
    """Largest resident set [MB] of an occlog command that must succeed."""
    quiet = [(os.POSIX_SPAWN_OPEN, 1, os.devnull, os.O_WRONLY, 0)]
    pid = os.posix_spawn(sys.executable, [sys.executable, "-m", "occlog", *args], os.environ, file_actions=quiet)
    _, status, usage = os.wait4(pid, 0)
    if os.waitstatus_to_exitcode(status) != 0:
        raise RuntimeError(f"occlog {' '.join(args)} failed")
    return usage.ru_maxrss / 1024


def measure(folder: Path, rows: int) -> dict[str, float]:
    """Peak of each command."""
    # In a process of its own: the system counts what a parent has in memory as its child's
    maker = multiprocessing.get_context("spawn").Process(target=make, args=(folder, rows))
    maker.start()
    maker.join()
    tracks, truth, errors = (str(folder / f"{name}.parquet") for name in ("tracks", "truth", "errors"))
    out = {"evaluate": peak_mb("evaluate", tracks, "--truth", truth, "--errors", errors, "--quiet")}
    shown = ("--truth", truth, "--errors", errors, "-o", str(folder / "page.html"))
    out["report"] = peak_mb("report", tracks, *shown)
    out["diff"] = peak_mb("diff", tracks, tracks)
    for name in ("csv", "tum", "mot3d"):
        out[f"export {name}"] = peak_mb("export", tracks, "--to", name, "-o", str(folder / f"out.{name}"))
        (folder / f"out.{name}").unlink()
    out["info"] = peak_mb("info", tracks)
    return out


def run(repeats: int) -> dict[str, Any]:  # noqa: ARG001
    """Ratio of the peaks, the largest of all commands; memory needs no repeats."""
    with tempfile.TemporaryDirectory() as name:
        short, long = (measure(Path(name) / str(rows), rows) for rows in (ROWS, 10 * ROWS))
    parts = {
        f"{command}: MB at {rows:.0e} rows": of[command]
        for command in short
        for rows, of in ((ROWS, short), (10 * ROWS, long))
    }
    return {"ratio": max(long[name] / short[name] for name in short), "limit": LIMIT, "parts": parts}
