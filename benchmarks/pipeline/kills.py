"""Commands that are killed, or that cannot write on: what is left, and what comes out when they are run again.

`python -m benchmarks.pipeline.kills COUNT [SEED]` ends each of the stages by SIGKILL, SIGTERM and SIGINT in turn, at
random times, COUNT times in all, and COUNT times lets no file grow beyond a random size (RLIMIT_FSIZE), as on a disk
that is full.
"""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from occlog.errors import ExitCode
from occlog.io.files.provenance import hash_file

NAME = "kills"
SUMMARY = "half outputs, files left over, tracebacks and other bytes after kills and full disks, of 11 a repeat of each"
LIMIT = 0.0
ROOM = Path(__file__).resolve().parents[2] / "examples" / "room.yaml"
CONFIGURATION = "occlog_run: 1\nseed: 1\ndetect: {}\ntrack: {particles: 50}\nevaluate: {}\n"
SWEEP = (
    "occlog_sweep: 1\nscene: scene.yaml\nseed: 1\nruns: 1\nsimulate: {steps: 15}\ntrack: {particles: 50}\n"
    "vary: {cameras: [2, 3]}\norder: [southwest, southeast, northeast]\n"
)
TIMES = ("timings.csv", "trials.jsonl")
"""Files that hold how long something took."""
HOW = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
DONE = (ExitCode.DONE, ExitCode.LOSSY, ExitCode.THRESHOLD)
STOPPED = {signal.SIGTERM: ExitCode.TERMINATED, signal.SIGINT: ExitCode.INTERRUPTED}


class Stage(NamedTuple):
    """A command and what it makes: files that must appear whole, or a folder that the same command goes on with."""

    arguments: str
    outputs: tuple[str, ...]
    folder: bool = False


STAGES = {
    "simulate": Stage("simulate scene.yaml -o r.mcap --steps 60 --seed 1 -q", ("r.mcap",)),
    "simulate --render": Stage(
        "simulate scene.yaml -o v.mcap --render --steps 12 --store ffv1 -q",
        ("v.mcap", *(f"v.{name}.avi" for name in ("northeast", "northwest", "southeast", "southwest"))),
    ),
    "detect": Stage("detect v.mcap -o b.parquet -q", ("b.parquet",)),
    "track": Stage("track r.mcap -o t.parquet --particles 300 -q", ("t.parquet",)),
    "evaluate": Stage("evaluate t.parquet --truth r.mcap -o m.json -q", ("m.json",)),
    "report": Stage("report t.parquet --scene r.mcap -o x.html -q", ("x.html",)),
    "export": Stage("export t.parquet -o t.csv", ("t.csv",)),
    "recover": Stage("recover r.mcap -o c.mcap", ("c.mcap",)),
    "run": Stage("run run.yaml -o run", ("run",), folder=True),
    "batch": Stage("batch batch.yaml r.mcap -o results", ("results",), folder=True),
    "sweep": Stage("sweep sweep.yaml -o sweep --workers 1", ("sweep",), folder=True),
}


class Place:
    """A folder with a scene, configurations and the outputs of all stages, each made once without being disturbed."""

    def __init__(self, folder: Path) -> None:
        """Make it."""
        self.folder, self.temporary = folder, folder / "temporary"
        self.temporary.mkdir()
        shutil.copy(ROOM, folder / "scene.yaml")
        (folder / "run.yaml").write_text(CONFIGURATION + "recording: r.mcap\n")
        (folder / "batch.yaml").write_text(CONFIGURATION)
        (folder / "sweep.yaml").write_text(SWEEP)
        self.seconds: dict[str, float] = {}
        self.good: dict[str, dict[str, str]] = {}
        for name, stage in STAGES.items():
            begun = time.monotonic()
            done = self.start(stage).wait()
            if done not in DONE:
                raise RuntimeError(f"{name} ended with exit code {done}")
            self.seconds[name], self.good[name] = time.monotonic() - begun, self.bytes_of(stage)

    def start(self, stage: Stage, *more: str, largest: int | None = None) -> subprocess.Popen[str]:
        """Begin a stage; no file of it grows beyond `largest` bytes."""
        limit = None if largest is None else partial(_limit, largest)
        return subprocess.Popen(
            [sys.executable, "-m", "occlog", *stage.arguments.split(), *more],
            cwd=self.folder,
            env={**os.environ, "TMPDIR": str(self.temporary)},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=limit,
        )

    def bytes_of(self, stage: Stage) -> dict[str, str]:
        """SHA-256 of the files that a stage made, but for those that hold times."""
        found: dict[str, str] = {}
        for name in stage.outputs:
            path = self.folder / name
            files = [p for p in path.rglob("*") if p.is_file()] if path.is_dir() else [path] if path.exists() else []
            found |= {str(p): hash_file(p) for p in files if p.name not in TIMES}
        return found

    def remove(self, stage: Stage) -> None:
        """Take away what a stage made."""
        for name in stage.outputs:
            path = self.folder / name
            if path.is_dir():
                shutil.rmtree(path)
            else:
                path.unlink(missing_ok=True)

    def left(self) -> bool:
        """Whether anything lies about that no stage makes."""
        return any("partial" in p.name for p in self.folder.rglob("*")) or any(self.temporary.iterdir())

    def again(self, name: str) -> bool:
        """Whether a stage that was stopped makes the same bytes when it is run again, and leaves nothing."""
        stage = STAGES[name]
        process = self.start(stage, *(() if stage.folder else ("--overwrite",)))
        process.communicate()
        return self.bytes_of(stage) == self.good[name] and not self.left()


def _limit(largest: int) -> None:
    import resource

    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))


def disturb(place: Place, name: str, how: int | None, rng: random.Random) -> list[str]:
    """Stop a stage by a signal, or (None) by a disk that is full; what went wrong, in words, and in how it ended."""
    stage, seconds = STAGES[name], place.seconds[name]
    place.remove(stage)
    largest = None if how is not None else int(10 ** rng.uniform(2.0, 5.0))
    process = place.start(stage, largest=largest)
    if how is not None:
        time.sleep(rng.uniform(0.1, 1.0) * seconds)
        process.send_signal(how)
    _, reported = process.communicate()
    code, found = process.returncode, place.bytes_of(stage)
    bad = []
    if not stage.folder and not found.items() <= place.good[name].items():
        bad.append("half output")
    if place.left() and how != signal.SIGKILL:
        bad.append("left over")
    if "Traceback" in reported or (how is None and code not in (*DONE, ExitCode.BAD_INPUT)):
        bad.append("traceback")
    if how in STOPPED and code not in (*DONE, STOPPED[signal.Signals(how)]):
        bad.append(f"exit code {code}")
    if not place.again(name):
        bad.append("other bytes when run again")
    return bad or ["all right" if code not in DONE else "had ended"]


def disturbed(count: int, seed: int) -> Counter[str]:
    """Disturb the stages in turn, so many times by each way; what came of it."""
    rng, outcomes = random.Random(seed), Counter[str]()
    with tempfile.TemporaryDirectory() as folder:
        place = Place(Path(folder))
        for k in range(2 * count):
            name, how = list(STAGES)[k % len(STAGES)], HOW[k // len(STAGES) % len(HOW)] if k < count else None
            way = "full disk" if how is None else how.name
            for outcome in disturb(place, name, how, rng):
                outcomes[f"{way}: {outcome}"] += 1
                if outcome not in ("all right", "had ended"):
                    print(f"{name}: {way}: {outcome}", file=sys.stderr)
    return outcomes


def run(repeats: int) -> dict[str, Any]:
    """Share of the disturbances after which something was wrong."""
    outcomes = disturbed(len(STAGES) * repeats, 1)
    wrong = sum(n for outcome, n in outcomes.items() if not outcome.endswith(("all right", "had ended")))
    return {"ratio": wrong / sum(outcomes.values()), "limit": LIMIT, "parts": dict(outcomes)}


if __name__ == "__main__":
    print(dict(disturbed(int(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 0)))
