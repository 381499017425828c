"""Methods that follow everybody, each put together of its parts."""

from __future__ import annotations

from occlog.track.jipda.filter import State, begin, step

from .stage import Follower

JIPDA: Follower[State] = Follower(begin=begin, step=step)
"""Method `jipda`."""
