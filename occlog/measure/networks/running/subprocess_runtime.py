"""A network that runs in a separate process, since inference runtimes may crash on an invalid one."""

from __future__ import annotations

import subprocess
import sys
import weakref
from contextlib import suppress
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from occlog.errors import InputError, UsageError
from occlog.io.files.children import enlarge_pipe, environment_for_children, exit_description
from occlog.io.formats.models.onnx_file import OnnxFile

from .messages import Feeds, receive, send

SECONDS = 600
"""Processor time of each thread, from one lot of images to the next [s]."""
MAX_OUTPUT_BYTES = 2**30
"""All outputs for a lot of images."""


class SubprocessRuntime:
    """A `Runtime` in another process, which ends with the last reference to this object.

    Attributes:
        called: name and version of the program that runs it.
    """

    def __init__(self, model: OnnxFile, runtime: str, threads: int) -> None:
        """Start the process and load the network.

        Args:
            model: description of the ONNX file.
            runtime: `opencv`, `onnxruntime` or `openvino`.
            threads: number of threads that the network may use.

        Raises:
            InputError: the runtime cannot load it, or crashes in doing so.
            UsageError: the runtime is not installed.
        """
        self._model = model
        self.called = runtime
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "occlog.measure.networks.running.process_main"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment_for_children(),
        )
        weakref.finalize(self, _end, self._process)
        for pipe in (self._process.stdin, self._process.stdout):
            enlarge_pipe(pipe)
        job = {"path": str(model.path), "runtime": runtime, "threads": threads}
        self.called = str(self._ask(job, {}, "loading")[0].get("called", runtime))

    def run(self, feeds: Feeds) -> dict[str, NDArray[np.generic]]:
        """Run the network on inputs by name; return the outputs by name.

        Raises:
            InputError: the runtime fails, crashes, or returns more than `MAX_OUTPUT_BYTES`.
        """
        return self._ask({}, feeds, "running")[1]

    def _ask(self, header: dict[str, Any], arrays: Feeds, doing: str) -> tuple[dict[str, Any], dict[str, Any]]:
        stdin: IO[bytes] = self._process.stdin  # type: ignore[assignment]
        stdout: IO[bytes] = self._process.stdout  # type: ignore[assignment]
        with suppress(BrokenPipeError):  # that it ended shows when it is read from
            send(stdin, header, arrays)
        try:
            answer, found = receive(stdout, MAX_OUTPUT_BYTES)
        except (EOFError, ValueError):
            stdout.close()
            raise InputError(
                f"{self._model.path}: {self.called} {self._death()} on {doing} this network; "
                "another runtime may take it, or export it again",
                id="unsupported-network",
            ) from None
        if "usage" in answer:
            raise UsageError(str(answer["usage"]))
        if "error" in answer:
            raise InputError(str(answer["error"]))
        return answer, found

    def _death(self) -> str:
        """Describe how the process ended, for messages; waits for it."""
        return exit_description(self._process.wait(), f"{SECONDS} s of each thread")


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a process, and close its pipes."""
    process.kill()
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with suppress(OSError):
                pipe.close()
    process.wait()
