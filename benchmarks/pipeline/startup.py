"""Processor time of commands that do next to nothing, beside that of `python -c pass`."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

NAME = "startup"
SUMMARY = "processor time of --help, schema, info and diff to that of `python -c pass`, and of the imports they need"
LIMIT = 4.0
ROOT = Path(__file__).resolve().parents[2]
TABLE = str(ROOT / "tests/golden/expected/simulated/tracks.parquet")
SCHEMA = str(ROOT / "schemas/tracks.json")
FLOOR = "import pyarrow.parquet, click"
COMMANDS = {
    "--help": ["--help"],
    "schema": ["schema", "tracks"],
    "diff of JSON": ["diff", SCHEMA, SCHEMA],
    "info of Parquet": ["info", TABLE],
    "diff of Parquet": ["diff", TABLE, TABLE],
}
WITHIN = ("--help", "schema", "diff of JSON")
"""Commands that the limit holds for; the others need NumPy and pyarrow, whose import alone takes more."""


def cpu_s(*args: str) -> float:
    """User and system time of a Python process that must succeed [s]."""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    quiet = [(os.POSIX_SPAWN_OPEN, 1, os.devnull, os.O_WRONLY, 0)]
    pid = os.posix_spawn(sys.executable, [sys.executable, *args], environment, file_actions=quiet)
    _, status, usage = os.wait4(pid, 0)
    if os.waitstatus_to_exitcode(status) != 0:
        raise RuntimeError(f"python {' '.join(args)} failed")
    return usage.ru_utime + usage.ru_stime


def run(repeats: int) -> dict[str, Any]:
    """Minima over three times as many repeats, taken in turn; the largest ratio that the limit holds for."""
    cases = {"pass": ["-c", "pass"], FLOOR: ["-c", FLOOR]}
    cases |= {name: ["-m", "occlog", *args] for name, args in COMMANDS.items()}
    for args in cases.values():
        cpu_s(*args)  # leaves bytecode behind
    least = {name: min(times) for name, times in _in_turn(cases, 3 * repeats).items()}
    ratios = {name: seconds / least["pass"] for name, seconds in least.items()}
    parts = {"ms of python -c pass": 1e3 * least["pass"]}
    parts |= {f"ratio of {name}": ratio for name, ratio in ratios.items() if name != "pass"}
    return {"ratio": max(ratios[name] for name in WITHIN), "limit": LIMIT, "parts": parts}


def _in_turn(cases: dict[str, list[str]], rounds: int) -> dict[str, list[float]]:
    times: dict[str, list[float]] = {name: [] for name in cases}
    for _ in range(rounds):
        for name, args in cases.items():
            times[name].append(cpu_s(*args))
    return times
