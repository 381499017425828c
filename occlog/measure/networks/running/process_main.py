"""The process that runs a network: `python -m occlog.measure.networks.running.process_main`.

It is started by `subprocess_runtime`. The first message on standard input names the network; each further one has its
inputs. Each is answered on standard output by the outputs, or by an error. The process ends when the requests end.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import IO, Any

from occlog.errors import InputError, UsageError
from occlog.io.formats.models.onnx_file import read_onnx
from occlog.io.frames.limits import CpuTimeLimit, lower_limits

from .messages import Feeds, receive, send
from .runtimes import Runtime, load, opencv_threads
from .subprocess_runtime import SECONDS


def main() -> None:
    """Load the network named by the first message, and run it for each request."""
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what programs write there is no message
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides what an interruption means
    lower_limits(memory=None)
    with suppress(BrokenPipeError, EOFError):
        job, _ = receive(sys.stdin.buffer)
        clock = CpuTimeLimit(seconds=SECONDS * max(1, job["threads"]))
        with opencv_threads(job["threads"]):
            network = _answered(out, partial(_load, job))
            while network is not None:
                feeds = receive(sys.stdin.buffer)[1]
                clock.go_on()
                _answered(out, partial(_run, network, feeds))
    os._exit(0)  # nothing is left to do, and threads of programs may hang in their clean-up


def _load(job: dict[str, Any]) -> tuple[Runtime, dict[str, str], Feeds]:
    network = load(read_onnx(Path(job["path"])), job["runtime"], job["threads"])
    return network, {"called": network.called}, {}


def _run(network: Runtime, feeds: Feeds) -> tuple[Runtime, dict[str, str], Feeds]:
    return network, {}, network.run(feeds)


def _answered(out: IO[bytes], work: Callable[[], tuple[Runtime, dict[str, str], Feeds]]) -> Runtime | None:
    """Do some work, and write its result to `out`; return the loaded network.

    If the work raises InputError or UsageError, that is written instead, and None returned. `work` returns the network,
    header and arrays of the answer.
    """
    try:
        network, header, arrays = work()
    except InputError as error:
        send(out, {"error": str(error)}, {})
        return None
    except UsageError as error:
        send(out, {"usage": str(error)}, {})
        return None
    send(out, header, arrays)
    return network


if __name__ == "__main__":
    main()
