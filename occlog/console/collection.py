"""Pause of Python's cyclic garbage collection while a command loads its modules.

Modules create some hundred thousand objects that stay; traversing them repeatedly is a tenth of the processor time of
a short command.
"""

from __future__ import annotations

import gc


class _Collection:
    """Whether this program has paused the collection."""

    def __init__(self) -> None:
        self._paused = False

    def pause(self) -> None:
        """Stop collections until `resume`; without effect if they are stopped already."""
        if gc.isenabled():
            gc.disable()
            self._paused = True

    def resume(self) -> None:
        """Allow collections after `pause`; they ignore the objects that exist now. Otherwise without effect."""
        if self._paused:
            self._paused = False
            gc.freeze()
            gc.enable()


COLLECTION = _Collection()
"""The collection of this process."""
