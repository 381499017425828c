"""What a floor plan with several paths is made of; see `planplot`."""

from __future__ import annotations

from typing import NamedTuple

from ..columns import Bools, Floats
from ..scene import Scene


class Path(NamedTuple):
    """An estimated path."""

    name: str  # as the legend has it
    xy: Floats  # (T, 2)


class Panel(NamedTuple):
    """One drawing of the room."""

    title: str
    truth: Floats  # (T, 2)
    seen: Bools  # (T,) a camera saw the target; there estimates have dots
    estimates: tuple[Path, ...]


class Plan(NamedTuple):
    """A picture: the same room again and again, with a path and its estimates."""

    title: str
    caption: str
    scene: Scene
    panels: tuple[Panel, ...]
    columns: int = 3
