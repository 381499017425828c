"""Processes that are forked by one that has loaded what they need."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from video_samples import number_shown, write_video

from occlog.io.frames.decoders import fork_server as nursery
from occlog.io.frames.decoders.fork_server import FORKS, ForkedProcess, ForkServer
from occlog.io.frames.decoders.process import DecodingJob, start_decoder

pytestmark = pytest.mark.skipif(not FORKS, reason="processes are forked on Linux only")
ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}


@pytest.fixture
def own() -> Iterator[ForkServer]:
    made = ForkServer()
    yield made
    made.stop()


def running(pid: int) -> bool:
    return Path(f"/proc/{pid}").exists()


def gone(*pids: int, seconds: float = 10.0) -> bool:
    end = time.monotonic() + seconds
    while any(running(pid) for pid in pids) and time.monotonic() < end:
        time.sleep(0.01)
    return not any(running(pid) for pid in pids)


def nursery_of(made: ForkServer) -> int:
    assert made._process is not None
    return made._process.pid


def close(*forked: ForkedProcess) -> None:
    for each in forked:
        each.kill()
        each.wait()
        each.stdin.close()
        each.stdout.close()


def test_it_says_how_its_processes_ended(own: ForkServer) -> None:
    quiet, killed, crashed = (own.fork(ENVIRONMENT) for _ in range(3))
    assert len({quiet.pid, killed.pid, crashed.pid}) == 3
    assert [each.poll() for each in (quiet, killed, crashed)] == [None] * 3
    os.kill(crashed.pid, signal.SIGSEGV)
    assert crashed.wait() == -signal.SIGSEGV
    killed.kill()
    assert killed.wait() == killed.poll() == -signal.SIGKILL
    assert quiet.poll() is None
    quiet.stdin.write(b"no job\n")
    quiet.stdin.close()
    assert quiet.wait() == 1  # a fault of whoever wrote that
    close(quiet, killed, crashed)
    assert gone(quiet.pid, killed.pid, crashed.pid)


def test_processes_end_with_whoever_listens_to_them_and_with_the_nursery(own: ForkServer) -> None:
    forgotten, kept = own.fork(ENVIRONMENT), own.fork(ENVIRONMENT)
    forgotten._line.close()
    assert gone(forgotten.pid)
    forgotten.returncode = 0
    close(forgotten)
    assert kept.poll() is None
    parent = nursery_of(own)
    own.stop()
    assert gone(kept.pid, parent)
    assert kept.wait() == -signal.SIGKILL
    close(kept)


def test_a_nursery_that_was_killed_is_replaced(own: ForkServer) -> None:
    close(own.fork(ENVIRONMENT))
    first = nursery_of(own)
    os.kill(first, signal.SIGKILL)
    assert own._process is not None
    own._process.wait()
    again = own.fork(ENVIRONMENT)
    assert again.poll() is None
    assert nursery_of(own) != first
    close(again)


def test_threads_may_ask_at_the_same_time(own: ForkServer) -> None:
    found: list[ForkedProcess] = []
    threads = [threading.Thread(target=lambda: found.append(own.fork(ENVIRONMENT))) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len({each.pid for each in found}) == 8
    close(*found)


def test_who_was_forked_itself_has_a_nursery_of_its_own(tmp_path: Path) -> None:
    video = write_video(tmp_path / "mp4v.mp4", 3)
    job = DecodingJob(kind="video", path=str(video), start=0, stop=None, store="raw", quality=0)

    def numbers() -> list[int]:
        with start_decoder(job) as decoder:
            return [number_shown(np.asarray(frame.image)) for frame in decoder.delivered()]

    assert numbers() == [0, 1, 2]
    pid = os.fork()
    if pid == 0:
        try:
            os._exit(0 if numbers() == [0, 1, 2] and nursery.FORK_SERVER._others else 1)
        finally:
            os._exit(2)
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0
    assert numbers() == [0, 1, 2]


def test_paths_start_from_the_folder_that_is_current_when_a_job_begins(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_video(tmp_path / "mp4v.mp4", 3)
    job = DecodingJob(kind="video", path="mp4v.mp4", start=0, stop=None, store="none", quality=0)
    monkeypatch.chdir(tmp_path)
    with start_decoder(job) as decoder:
        assert len(list(decoder.delivered())) == 3


SCRIPT = """
import os, sys
from occlog.io.frames.decoders.process import start_decoder
found = [start_decoder({"kind": "messages", "path": "x", "store": "raw", "quality": 0}) for _ in range(2)]
print(*(each.process.pid for each in found), flush=True)
sys.stdin.read()
"""


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM, None])
def test_nothing_is_left_of_a_program_that_ended(how: signal.Signals | None) -> None:
    program = subprocess.Popen(
        [sys.executable, "-c", SCRIPT], env=ENVIRONMENT, stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert program.stdin is not None
    assert program.stdout is not None
    pids = [int(each) for each in program.stdout.readline().split()]
    assert len(pids) == 2
    assert all(running(pid) for pid in pids)
    if how is not None:
        os.kill(program.pid, how)
    program.communicate()
    assert gone(*pids)
