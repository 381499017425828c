"""Fewer moments of a long recording: what viewers keep in memory grows with what a file holds."""

from __future__ import annotations

from .moments import Drawn, Moment, Over, Said


class Thinner:
    """Keeps the first moment of each topic in each stretch of time.

    Each message says all that its topic shows, so that any of them may be left out.  Stretches are the same for all
    topics: images and what is drawn over the floor stay near each other.  Lines of the log are all kept.
    """

    def __init__(self, every_ns: int) -> None:
        """Stretches of so many nanoseconds, counted from the first moment."""
        self._every_ns = every_ns
        self._begin: int | None = None
        self._kept: dict[str, int] = {}
        self._shown: set[str] = set()  # topics whose last message shows something

    def keeps(self, moment: Moment) -> bool:
        """Whether a moment is written; moments come in the order of time."""
        if isinstance(moment, Said):
            return True
        topic, t_ns = (
            (f"image of {moment.frame.sensor}", moment.frame.t_ns)
            if isinstance(moment, Over)
            else (moment.topic, moment.t_ns)
        )
        self._begin = t_ns if self._begin is None else self._begin
        if isinstance(moment, Drawn) and not moment.things:
            # Nothing any more: what was drawn last would stay for ever
            shown = topic in self._shown
            self._shown.discard(topic)
            return shown
        stretch = (t_ns - self._begin) // self._every_ns
        if self._kept.get(topic) == stretch:
            return False
        self._kept[topic] = stretch
        self._shown.add(topic)
        return True
