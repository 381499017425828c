"""Fork server for decoding processes, which start in a fifth of the time since libraries are loaded already.

The fork server is `python -m occlog.io.frames.decoders.fork_server`, started once on first use.  It loads
OpenCV, decodes nothing itself, and forks a process for each request.  It ends with the process that started it, and
takes those that it forked with it.

A request is one byte with three or four descriptors: for standard input and standard output of the new
process, its line, over which go, to the parent, its number and, when it has ended, how, and back, that it be killed;
and memory that it shares.
"""

from __future__ import annotations

import atexit
import gc
import os
import selectors
import signal
import socket
import struct
import subprocess
import sys
import threading
from contextlib import suppress
from dataclasses import dataclass, field
from typing import IO, NoReturn

FORKS = sys.platform == "linux"
"""True where processes are forked; elsewhere libraries that were loaded before a fork may not work after it."""
PATIENCE = 5.0
"""Time for the fork server to end its processes and itself [s]."""
_REQUEST, _KILL = b"F", b"K"
_NUMBER = struct.Struct("i")


@dataclass
class ForkedProcess:
    """A process forked by the fork server, with the interface of `subprocess.Popen`.

    Attributes:
        stdin: pipe to its standard input.
        stdout: pipe from its standard output.
        pid: process id.
        returncode: exit code, or minus the number of the signal that ended it; None while it runs.
    """

    stdin: IO[bytes]
    stdout: IO[bytes]
    _line: socket.socket = field(repr=False)
    pid: int = 0
    returncode: int | None = None

    def poll(self) -> int | None:
        """Exit code, or minus the number of the signal that ended the process; None while it runs. Does not wait."""
        if self.returncode is None:
            self._line.setblocking(False)
            with suppress(BlockingIOError):
                self._end(self._line.recv(_NUMBER.size))
        return self.returncode

    def wait(self) -> int:
        """Wait for the end of the process; return its exit code, or minus the number of the signal that ended it."""
        if self.returncode is None:
            self._line.setblocking(True)
            self._end(self._line.recv(_NUMBER.size))
        return self.returncode or 0

    def kill(self) -> None:
        """Ask the fork server to kill the process, if it still runs; does not wait."""
        if self.returncode is None:
            with suppress(OSError):
                self._line.send(_KILL)

    def _end(self, reported: bytes) -> None:
        # Without a word the fork server itself was killed, and those of its processes that ran with it
        self.returncode = _NUMBER.unpack(reported)[0] if reported else -signal.SIGKILL
        self._line.close()


class ForkServer:
    """Client side of a server process that forks decoding processes; the server is started on first use."""

    def __init__(self) -> None:
        """Create a fork server that is not started."""
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._requests: socket.socket | None = None
        self._others: list[subprocess.Popen[bytes]] = []  # of processes that this one was forked from

    def fork(self, environment: dict[str, str], memory: int | None = None) -> ForkedProcess:
        """Fork a process that runs the job on its standard input (`process_main`).

        Args:
            environment: environment variables of the fork server, if it has to be started.
            memory: descriptor of memory to share with the new process; None: nothing.

        Raises:
            OSError: the fork server cannot be started, or has ended.
        """
        given, stdin = os.pipe()
        stdout, taken = os.pipe()
        line, far = socket.socketpair()
        sent = [given, taken, far.fileno(), *(() if memory is None else (memory,))]
        try:
            with self._lock:
                try:
                    self._send(environment, sent)
                except (BrokenPipeError, ConnectionResetError):  # it was killed
                    self._stop()
                    self._send(environment, sent)
        except BaseException:
            for each in (stdin, stdout):
                os.close(each)
            line.close()
            raise
        finally:
            for each in (given, taken):
                os.close(each)
            far.close()
        forked = ForkedProcess(os.fdopen(stdin, "wb"), os.fdopen(stdout, "rb"), line)
        reported = line.recv(_NUMBER.size)
        if not reported:
            for pipe in (forked.stdin, forked.stdout):
                pipe.close()
            line.close()
            raise OSError("the process that starts the decoders of video has ended; run the command again")
        forked.pid = _NUMBER.unpack(reported)[0]
        return forked

    def _send(self, environment: dict[str, str], descriptors: list[int]) -> None:
        if self._requests is None:
            self._requests, far = socket.socketpair()
            with far:
                self._process = subprocess.Popen(
                    [sys.executable, "-P", "-m", __name__],
                    stdin=far.fileno(),
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                    env=environment,
                )
        socket.send_fds(self._requests, [_REQUEST], descriptors)

    def _stop(self) -> None:
        """End the fork server and all processes that it forked."""
        if self._requests is not None:
            self._requests.close()
        if self._process is not None:
            try:
                self._process.wait(PATIENCE)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        self._process = self._requests = None

    def stop(self) -> None:
        """End the fork server and its processes; it is started again when a process is requested."""
        with self._lock:
            self._stop()

    def forget(self) -> None:
        """Let go of the fork server, without ending it, in a child after this process was forked."""
        self._lock = threading.Lock()
        if self._requests is not None:
            self._requests.close()
        if self._process is not None:
            self._others.append(self._process)
        self._process = self._requests = None


FORK_SERVER = ForkServer()
atexit.register(FORK_SERVER.stop)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=FORK_SERVER.forget)


class _Served:
    """The fork server itself: its child processes, and the descriptors that wake it.

    Attributes:
        memory: in a forked child, descriptor of the memory that it shares with its client; None: nothing.
    """

    def __init__(self) -> None:
        self.memory: int | None = None
        self._requests = socket.socket(fileno=os.dup(0))
        self._lines: dict[int, socket.socket] = {}
        self._wake, written = socket.socketpair()
        self._wake.setblocking(False)
        written.setblocking(False)
        self._written = written
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.set_wakeup_fd(written.fileno())
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._requests, selectors.EVENT_READ)
        self._selector.register(self._wake, selectors.EVENT_READ)

    def serve(self) -> None:
        """Answer requests of the client; returns in a forked child only, and exits when the client has closed."""
        while True:
            for key, _ in self._selector.select():
                if key.fileobj is self._requests:
                    byte, descriptors, *_ = socket.recv_fds(self._requests, 1, 4)
                    if not byte:
                        self._end()
                    if self._fork(descriptors):
                        return
                elif key.fileobj is self._wake:
                    with suppress(BlockingIOError):
                        self._wake.recv(4096)
                    self._bury()
                else:
                    self._hear(key.data)

    def _fork(self, descriptors: list[int]) -> bool:
        """Fork; True in the child, which has the received descriptors as standard input and output.

        Args:
            descriptors: standard input, standard output, line to the client and, if any, shared memory; closed in both.
        """
        stdin, stdout, line, *memory = descriptors
        pid = os.fork()
        if pid == 0:
            signal.set_wakeup_fd(-1)
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            self._selector.close()
            for end in (self._requests, self._wake, self._written, *self._lines.values()):
                end.close()
            os.dup2(stdin, 0)
            os.dup2(stdout, 1)
            if memory:
                self.memory = os.dup(memory[0])
        else:
            kept = self._lines[pid] = socket.socket(fileno=os.dup(line))
            self._selector.register(kept, selectors.EVENT_READ, pid)
            with suppress(OSError):
                kept.send(_NUMBER.pack(pid))
        for each in descriptors:
            os.close(each)
        return pid == 0

    def _hear(self, pid: int) -> None:
        """Kill the child `pid`, since its client asks for it or has closed the line."""
        if pid in self._lines:
            with suppress(OSError):
                self._lines[pid].recv(1)
            os.kill(pid, signal.SIGKILL)  # it has not been waited for: the number is still its own
            self._selector.unregister(self._lines[pid])

    def _bury(self) -> None:
        """Wait for each child that has ended, and report its exit status to its client."""
        while self._lines:
            pid, status = os.waitpid(-1, os.WNOHANG)
            if pid == 0:
                return
            line = self._lines.pop(pid)
            with suppress(KeyError):
                self._selector.unregister(line)
            with suppress(OSError):
                line.send(_NUMBER.pack(os.waitstatus_to_exitcode(status)))
            line.close()

    def _end(self) -> NoReturn:
        for pid in self._lines:
            os.kill(pid, signal.SIGKILL)
        os._exit(0)


def main() -> None:
    """Run the fork server: load the decoding libraries, answer requests, and in a forked child decode its job."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides what an interruption means
    gc.disable()  # loaded objects stay; traversing them repeatedly takes time
    from . import process_main

    process_main.load()
    gc.freeze()  # a collection would write to all objects, and so copy the memory that forked processes share
    gc.enable()
    served = _Served()
    served.serve()
    process_main.main(served.memory)


if __name__ == "__main__":
    main()
