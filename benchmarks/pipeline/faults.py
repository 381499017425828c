"""Commands whose writes fail: an error of the device at each write, and a disk that is full from there on.

`python -m benchmarks.pipeline.faults [PLACES] [STAGE...]` counts the operations that write (write, fsync, truncate,
rename, link, mkdir) of each stage of `kills.py`, in all its processes, and lets each of them fail in turn, or PLACES of
them evenly: once with EIO, once with ENOSPC that lasts.  Needs a C compiler.
"""

from __future__ import annotations

import errno
import os
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np

from occlog.errors import ExitCode

from .kills import DONE, STAGES, Place

SOURCE = Path(__file__).with_name("failing_writes.c")
WAYS = {"EIO": (errno.EIO, False), "ENOSPC": (errno.ENOSPC, True)}
OLD = b"what was here before"
REFUSED = (ExitCode.BAD_INPUT,)


class Faults:
    """Stages of which operations that write fail."""

    def __init__(self, folder: Path) -> None:
        """Build the library, and make the outputs of all stages once."""
        self.library, self.counter = folder / "failing.so", folder / "count"
        subprocess.run(["cc", "-shared", "-fPIC", "-O1", "-o", self.library, SOURCE, "-ldl"], check=True)
        (folder / "work").mkdir()
        self.place = Place(folder / "work")

    def start(self, name: str, at: int, error: int, lasts: bool) -> tuple[int, str, int]:
        """Exit code, what was said, and the number of operations of a stage, the one of that number failing."""
        stage, place = STAGES[name], self.place
        self.counter.write_bytes(bytes(8))
        reported = {
            "FAULT_FOLDER": str(place.folder), "FAULT_COUNTER": str(self.counter), "FAULT_AT": str(at),
            "FAULT_ERRNO": str(error), "FAULT_LASTS": str(int(lasts)), "LD_PRELOAD": str(self.library),
        }  # fmt: skip
        done = subprocess.run(
            [sys.executable, "-m", "occlog", *stage.arguments.split(), *(() if stage.folder else ("--overwrite",))],
            cwd=place.folder,
            env={**os.environ, "TMPDIR": str(place.temporary), **reported},
            capture_output=True,
            text=True,
            timeout=120,
        )
        return done.returncode, done.stderr, int.from_bytes(self.counter.read_bytes(), "little")

    def before(self, name: str) -> None:
        """What lies there when a stage begins: outputs of before, or no folder."""
        stage = STAGES[name]
        self.place.remove(stage)
        for output in () if stage.folder else stage.outputs:
            (self.place.folder / output).write_bytes(OLD)

    def tried(self, name: str, at: int, way: str) -> list[str]:
        """What went wrong, in words, where an operation fails; empty: nothing."""
        stage, place = STAGES[name], self.place
        self.before(name)
        code, reported, _ = self.start(name, at, *WAYS[way])
        bad = []
        if "Traceback" in reported or code < 0 or code == ExitCode.BUG:
            bad.append("traceback")
        elif code not in (*DONE, *REFUSED):
            bad.append(f"exit code {code}")
        elif code in REFUSED and not any(mark in reported for mark in ("occlog: error:", "occlog: failed:")):
            bad.append("not a line")
        if not stage.folder:
            files = [place.folder / output for output in stage.outputs]
            old = [path.is_file() and path.read_bytes() == OLD for path in files]
            new = [place.bytes_of(stage).get(str(path)) == place.good[name][str(path)] for path in files]
            if not (all(new) or (code in REFUSED and all(old))):
                bad.append(f"half output (old {old}, new {new})")
        elif code in DONE and place.bytes_of(stage) != place.good[name]:
            bad.append("other bytes, and said to be done")
        if place.left():
            bad.append("left over")
            shutil.rmtree(place.temporary)
            place.temporary.mkdir()
        if not place.again(name):
            bad.append("other bytes when run again")
        return [f"{each}: {reported.strip()[-300:]!r}" for each in bad]


def main(words: list[str]) -> int:
    """Let operations fail, and print what came of it."""
    places = int(words[0]) if words else 10**9
    outcomes = Counter[str]()
    with tempfile.TemporaryDirectory() as folder:
        faults = Faults(Path(folder).resolve())
        for name in words[1:] or STAGES:
            faults.before(name)
            code, reported, count = faults.start(name, 0, 0, False)
            if code not in DONE:
                raise RuntimeError(f"{name}: {reported}")
            chosen = np.unique(np.linspace(1, count, min(places, count)).round().astype(int)).tolist()
            for way in WAYS:
                for at in chosen:
                    bad = faults.tried(name, at, way)
                    outcomes["wrong" if bad else "all right"] += 1
                    for each in bad:
                        print(f"{name}: {way} at {at} of {count}: {each}", file=sys.stderr)
            print(f"{name}: {len(chosen)} of {count} operations, each way", flush=True)
    print(dict(outcomes))
    return int(outcomes["wrong"] > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
