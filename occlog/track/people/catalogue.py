"""Methods that follow everybody, each put together of its parts."""

from __future__ import annotations

from occlog.track.jipda.batch.window import Window, add, finish
from occlog.track.jipda.filter import State, begin, step
from occlog.track.jipda.hearing import hear

from .stage import Follower, Future

JIPDA: Follower[State, Window] = Follower(begin=begin, step=step, hear=hear, future=Future(Window, add, finish))
"""Method `jipda`."""
