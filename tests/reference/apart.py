"""Runs of a command in a process of its own, with the memory and the processor time that it took.

The processes are forked from one that has imported what the commands need, so that a run costs no start of Python.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path
from typing import NamedTuple

MOST_KIB = (512 + 100) * 1024
"""Memory that a command may have taken, at most: half a gigabyte above what the smallest file needs."""
MOST_SECONDS = 10
"""Processor time of a command at most: that of other work on the machine does not count."""
PROGRAM = Path(__file__)


class Outcome(NamedTuple):
    """How a command ended.

    Attributes:
        code: its exit code; below 0: the signal that ended it.
        output: what it wrote, to standard output and standard error.
        kib: memory that it took at most [KiB].
        seconds: processor time [s].
    """

    code: int
    output: str
    kib: int
    seconds: float


@cache
def _server() -> subprocess.Popen[str]:
    return subprocess.Popen([sys.executable, PROGRAM], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def run_apart(*arguments: object) -> Outcome:
    """Run a command; one that is far beyond `MOST_SECONDS` is stopped."""
    server = _server()
    assert server.stdin is not None
    assert server.stdout is not None
    with tempfile.TemporaryDirectory() as folder:
        asked = {"arguments": [*map(str, arguments)], "folder": folder, "cwd": str(Path.cwd()), "env": dict(os.environ)}
        server.stdin.write(f"{json.dumps(asked)}\n")
        server.stdin.flush()
        code, seconds = json.loads(server.stdout.readline())
        reported = "".join((Path(folder) / name).read_text() for name in ("out", "err"))
        memory = Path(folder) / "memory"
        return Outcome(code, reported, int(memory.read_text()) if memory.exists() else 0, seconds)


def check_apart(*arguments: object) -> Outcome:
    """Run a command that must keep what is promised of small files: memory, time, no traceback."""
    outcome = run_apart(*arguments)
    assert "Traceback" not in outcome.output
    assert 0 < outcome.kib < MOST_KIB, outcome
    assert outcome.seconds < MOST_SECONDS, outcome
    return outcome


def _serve() -> None:
    """Fork a process for each line of standard input, and write how it ended."""
    import occlog.examine.doctor.run
    import occlog.examine.export.run
    import occlog.examine.info
    import occlog.ingest.run  # noqa: F401 - what the commands of the tests import

    for line in sys.stdin:
        asked = json.loads(line)
        child = os.fork()
        if child == 0:
            _run(asked)
        _, status, used = os.wait4(child, 0)
        sys.stdout.write(f"{json.dumps((os.waitstatus_to_exitcode(status), used.ru_utime + used.ru_stime))}\n")
        sys.stdout.flush()


def _run(asked: dict[str, object]) -> None:
    """Be the process of a command."""
    import resource
    import traceback

    from occlog.cli.main import run

    os.chdir(str(asked["cwd"]))
    os.environ.clear()
    os.environ.update(asked["env"])  # type: ignore[call-overload]
    folder = Path(str(asked["folder"]))
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    for descriptor, name in ((1, "out"), (2, "err")):
        os.dup2(os.open(folder / name, os.O_WRONLY | os.O_CREAT), descriptor)
    resource.setrlimit(resource.RLIMIT_CPU, (10 * MOST_SECONDS,) * 2)
    code = 1
    try:
        code = run(asked["arguments"])  # type: ignore[arg-type]
    except BaseException:
        traceback.print_exc()
    sys.stdout.flush()
    sys.stderr.flush()
    status = Path("/proc/self/status").read_text().splitlines()
    (folder / "memory").write_text(*(line.split()[1] for line in status if line.startswith("VmHWM")))
    os._exit(code)


if __name__ == "__main__":
    _serve()
