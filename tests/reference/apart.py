"""Runs of a command in a process of its own, whose memory and processor time are known."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import NamedTuple

MOST_KIB = (512 + 100) * 1024
"""Memory that a command may have taken, at most: half a gigabyte above what the smallest file needs."""
MOST_SECONDS = 10
"""Processor time of a command at most: that of other work on the machine does not count."""
_PROGRAM = (
    "import resource, sys; from occlog.cli.main import run;"
    "resource.setrlimit(resource.RLIMIT_CPU, (10 * int(sys.argv[1]),) * 2); code = run(sys.argv[2:]);"
    "print(*[line.split()[1] for line in open('/proc/self/status') if line.startswith('VmHWM')]); sys.exit(code)"
)


class Outcome(NamedTuple):
    """How a command ended.

    Attributes:
        code: its exit code.
        told: what it wrote, to standard output and standard error.
        kib: memory that it took at most [KiB].
        seconds: processor time [s].
    """

    code: int
    told: str
    kib: int
    seconds: float


def run_apart(*arguments: object) -> Outcome:
    """Run a command; one that is far beyond `MOST_SECONDS` is stopped."""
    before = os.times()
    words = [sys.executable, "-c", _PROGRAM, str(MOST_SECONDS), *map(str, arguments)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=600, check=False)
    after = os.times()
    seconds = after.children_user - before.children_user + after.children_system - before.children_system
    out, _, last = done.stdout.rstrip("\n").rpartition("\n")
    kib = int(last) if last.isdigit() else 0
    return Outcome(done.returncode, f"{out}\n{done.stderr}", kib, seconds)


def check_apart(*arguments: object) -> Outcome:
    """Run a command that must keep what is promised of small files: memory, time, no traceback."""
    outcome = run_apart(*arguments)
    assert "Traceback" not in outcome.told
    assert 0 < outcome.kib < MOST_KIB, outcome
    assert outcome.seconds < MOST_SECONDS, outcome
    return outcome
