"""A batch of recordings of 10 s: with two workers to one, with one to a plain loop, and killed again and again.

OCCLOG_BATCH_RECORDINGS and OCCLOG_BATCH_KILLS say how many of each.  Every way is a program of its own, its
start included, and works on the same recordings.
"""

from __future__ import annotations

import hashlib
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any

NAME = "batch"
SUMMARY = "batch of recordings of 10 s: time with two workers to that with one; overhead over a plain loop; kills"
LIMIT = 1 / 1.85
ROOM = Path(__file__).resolve().parents[2] / "examples" / "room.yaml"
RECORDINGS = int(os.environ.get("OCCLOG_BATCH_RECORDINGS", "24"))
KILLS = int(os.environ.get("OCCLOG_BATCH_KILLS", "20"))
CONFIG = "occlog_run: 1\nseed: 1\n"
LOOP = """
import sys
from pathlib import Path
from occlog.cli.main import run
for path in sorted(Path(sys.argv[1]).glob("*.mcap")):
    config = path.with_suffix(".yaml")
    config.write_text(sys.argv[2] + f"recording: {path.name}\\n")
    if run(["run", str(config), "-o", str(Path(sys.argv[3]) / path.stem), "-q"]):
        raise SystemExit(1)
"""
"""The plain loop: `occlog run` of one recording after another, in one process."""
SIMULATE = """
import sys
from pathlib import Path
from occlog.cli.main import run
for seed in range(int(sys.argv[3])):
    made = ["-o", str(Path(sys.argv[2]) / f"{seed:04}.mcap"), "--seed", str(seed), "-q"]
    if run(["simulate", sys.argv[1], *made, "--seconds", "10", "--occluders", "3"]):
        raise SystemExit(1)
"""
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS", "OCCLOG_THREADS"), "1")
ENVIRONMENT = {**os.environ, **ONE_THREAD, "PYTHONPATH": os.pathsep.join(sys.path)}


def run(repeats: int) -> dict[str, Any]:
    """Ratio of wall-clock times, all ways taken in turn; medians over repeats."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        recordings = _recordings(folder / "recordings")
        times: dict[str, list[tuple[float, float]]] = {"loop": [], "one": [], "two": []}
        _timed(
            ["-m", "occlog", *_batch(folder, recordings, folder / "first", 1, "0000")]
        )  # leaves compiled code behind
        for _ in range(min(repeats, 3)):
            shutil.rmtree(folder / "out", ignore_errors=True)
            (folder / "out" / "loop").mkdir(parents=True)
            times["loop"].append(_timed(["-c", LOOP, str(recordings), CONFIG, str(folder / "out" / "loop")]))
            for workers, out in ((1, "one"), (2, "two")):
                args = _batch(folder, recordings, folder / "out" / out, workers)
                times[out].append(_timed(["-m", "occlog", *args]))
        whole = _digests(folder / "out" / "one")
        if _digests(folder / "out" / "two") != whole:
            raise AssertionError("results depend on the number of workers")
        for path in (folder / "out" / "loop").rglob("*"):
            if path.is_file() and whole[f"runs/{path.relative_to(folder / 'out' / 'loop')}"] != _digest(path):
                raise AssertionError(f"{path.name} of the loop has other bytes than that of the batch")
        killed = _kills(folder, recordings, whole)
    wall = {way: median(w for w, _ in found) for way, found in times.items()}
    two_to_one = median(two / one for (one, _), (two, _) in zip(times["one"], times["two"], strict=True))
    return {
        "ratio": two_to_one,
        "limit": LIMIT,
        "parts": {
            "recordings": RECORDINGS,
            "repeats": len(times["loop"]),
            **{f"{way} wall s": seconds for way, seconds in wall.items()},
            "throughput of two workers to one": 1 / two_to_one,
            "one worker to the loop, wall": median(
                one / loop for (loop, _), (one, _) in zip(times["loop"], times["one"], strict=True)
            ),
            "one worker to the loop, processor": median(
                one / loop for (_, loop), (_, one) in zip(times["loop"], times["one"], strict=True)
            ),
            "kills": KILLS,
            **killed,
            "load of the machine": os.getloadavg()[1],
        },
    }


def _recordings(folder: Path) -> Path:
    folder.mkdir()
    _timed(["-c", SIMULATE, str(ROOM), str(folder), str(RECORDINGS)])
    (folder.parent / "batch.yaml").write_text(CONFIG)
    return folder


def _batch(folder: Path, recordings: Path, out: Path, workers: int, name: str = "*") -> list[str]:
    pattern = str(recordings / f"{name}.mcap")
    return ["batch", str(folder / "batch.yaml"), pattern, "-o", str(out), "-q", "--workers", str(workers)]


def _timed(args: list[str]) -> tuple[float, float]:
    """Wall-clock and processor time [s] of a program that must succeed, its children included."""
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run([sys.executable, *args], env=ENVIRONMENT, check=True, stdout=subprocess.DEVNULL)
    wall, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _digests(folder: Path) -> dict[str, str]:
    """Hash of every file but that of times, hidden ones included."""
    files = (path for path in folder.rglob("*") if path.is_file() and path.name != "timings.csv")
    return {str(path.relative_to(folder)): _digest(path) for path in files}


def _kills(folder: Path, recordings: Path, whole: dict[str, str]) -> dict[str, float]:
    """Kill a batch at random times, again and again in one folder, then let it end: its bytes are to be `whole`."""
    out, draw, finished = folder / "killed", random.Random(1), 0
    args = [sys.executable, "-m", "occlog", *_batch(folder, recordings, out, 2)]
    for _ in range(KILLS):
        program = subprocess.Popen(args, env=ENVIRONMENT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            program.wait(draw.uniform(1.0, 20.0))
            finished += 1
            shutil.rmtree(out)  # all was done: begin anew
        except subprocess.TimeoutExpired:
            program.send_signal(signal.SIGKILL)
            program.wait()
    subprocess.run(args, env=ENVIRONMENT, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    found = _digests(out)
    wrong = sum(found.get(name) != digest for name, digest in whole.items())
    return {"killed in the midst": KILLS - finished, "files that differ": wrong + len(set(found) - set(whole))}
