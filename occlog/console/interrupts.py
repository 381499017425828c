"""Handling of Ctrl-C and SIGTERM, which end the program once with cleanup, wherever they arrive.

Python drops exceptions raised in finalisers and in callbacks of compiled code. An interrupt that arrives there is
stored and raised later. While numba creates a named tuple as a result, an exception would crash the process, so that
the interrupt is delayed.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from types import FrameType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

USUAL = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}
"""Signals that are taken over, and what Python does of itself."""
NOT_THERE = ("numba.core.serialize", "namedtuple_")
"""Prefixes of modules with functions that numba calls to make results: `collections` for constructors of classes."""
AGAIN_S = 0.05
"""An interrupt that was dropped comes again so much later, so that the callback has ended."""


class Interrupts:
    """State of the interrupts (SIGINT, SIGTERM) of this process.

    Attributes:
        asked: there was one.
        terminated: one was SIGTERM.
        raised: KeyboardInterrupt was raised where it takes effect; further ones are ignored during the cleanup.
    """

    def __init__(self) -> None:
        """Create the state before any interrupt or termination signal."""
        self.asked = self.raised = self.terminated = self._waiting = False

    def install(self) -> None:
        """Install handlers of SIGINT and SIGTERM (unless ignored), and of exceptions that Python drops."""
        for number, usual in USUAL.items():
            if signal.getsignal(number) == usual:
                signal.signal(number, self._arrived)
        # Who is forked ends by SIGTERM as any process does
        if hasattr(os, "register_at_fork"):
            os.register_at_fork(after_in_child=_usual_end)
        sys.unraisablehook = self._dropped

    def check(self) -> None:
        """Raise an interrupt that Python had dropped; called between the steps of every command.

        Raises:
            KeyboardInterrupt: there was an interrupt, and none has been raised yet.
        """
        if self.asked and not self.raised:
            self.raised = True
            raise KeyboardInterrupt

    def end(self) -> None:
        """Ignore interrupts from now on, since the program ends."""
        self.raised = True
        for number in USUAL:
            if signal.getsignal(number) == self._arrived:
                signal.signal(number, signal.SIG_IGN)
        if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
            # An interrupt that left code which ran from text, as imports do, would make CPython kill itself by SIGINT
            # instead of leaving with the exit code; the next text that runs makes it forget
            exec("")

    def _arrived(self, number: int, frame: FrameType | None) -> None:
        if self.raised:
            return
        self.terminated = self.terminated or number == signal.SIGTERM
        if frame is not None and str(frame.f_globals.get("__name__", "")).startswith(NOT_THERE):
            self._later()
            return
        self.asked = True
        raise KeyboardInterrupt

    def _dropped(self, unraisable: UnraisableHookArgs) -> None:
        """Store a dropped interrupt, to be raised again; show any other dropped exception."""
        if not issubclass(unraisable.exc_type, KeyboardInterrupt):
            sys.__unraisablehook__(unraisable)
        else:
            self._later()

    def _later(self) -> None:
        if not self._waiting:
            self._waiting = True
            again = threading.Timer(AGAIN_S, self._again)
            again.daemon = True
            again.start()

    def _again(self) -> None:
        self._waiting = False
        if not self.raised:
            os.kill(os.getpid(), signal.SIGINT)


def _usual_end() -> None:
    if signal.getsignal(signal.SIGTERM) == INTERRUPTS._arrived:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


INTERRUPTS = Interrupts()
