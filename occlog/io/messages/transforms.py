"""The tree of frames of reference of a bag, and where frames stand that must not move.

Transforms come all the time; of each pair of frames the first pose is kept, and how far later ones were from it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError

from .kinds import TransformMessage

STILL_M, STILL_RAD = 0.02, math.radians(0.5)
"""Up to this, changes of a pose are taken for noise of the localisation; what moves more is no fixed camera."""
UNIT_SLACK = 0.01
MAX_DEPTH = 200


@dataclass
class Edge:
    """The pose of a frame in its parent: the first one, and the largest change since."""

    parent: str
    rotation: Floats  # (3, 3) parent-from-child
    translation: Floats
    messages: int = 1
    moved: float = 0.0
    turned: float = 0.0

    @property
    def still(self) -> bool:
        """Whether it never moved by more than noise does."""
        return self.moved <= STILL_M and self.turned <= STILL_RAD


class Placed(NamedTuple):
    """A pose in another frame: x_other = rotation x + translation."""

    rotation: Floats
    translation: Floats


class Transforms:
    """The frames of a bag."""

    def __init__(self) -> None:
        """Begin without frames."""
        self.edges: dict[str, Edge] = {}
        self.faults: dict[str, str] = {}

    def add(self, message: TransformMessage) -> None:
        """Take a transform; one that is no pose is told when its frame is needed."""
        try:
            rotation = rotation_of(message)
        except InputError as error:
            self.faults.setdefault(message.child, str(error))
            return
        old = self.edges.get(message.child)
        if old is None:
            self.edges[message.child] = Edge(message.parent, rotation, message.translation)
            return
        if old.parent != message.parent:
            text = f"frame {message.child!r} has two parents, {old.parent!r} and {message.parent!r}"
            self.faults.setdefault(message.child, text)
            return
        old.messages += 1
        old.moved = max(old.moved, float(np.linalg.norm(message.translation - old.translation)))
        cosine = (float(np.trace(old.rotation.T @ rotation)) - 1) / 2
        old.turned = max(old.turned, math.acos(min(max(cosine, -1.0), 1.0)))

    @property
    def frames(self) -> list[str]:
        """Names of all frames, sorted."""
        return sorted({*self.edges, *(edge.parent for edge in self.edges.values())})

    def knows(self, frame: str) -> bool:
        """Whether a frame is in the tree."""
        return frame in self.edges or any(edge.parent == frame for edge in self.edges.values())

    def chain(self, frame: str) -> list[str]:
        """The frame, its parent, and so on up to the root; InputError where frames are each other's parents."""
        out = [frame]
        while out[-1] in self.edges:
            parent = self.edges[out[-1]].parent
            if parent in out or len(out) > MAX_DEPTH:
                raise InputError(f"transforms: frame {parent!r} is its own parent; the tree has no root")
            out.append(parent)
        return out

    def still_root(self, frame: str) -> str:
        """The highest frame in which a frame does not move."""
        for above in self.chain(frame):
            if above not in self.edges or not self.edges[above].still:
                return above
        raise AssertionError("a chain ends at a frame without a parent")

    def placed(self, frame: str, world: str) -> Placed:
        """The pose of a frame in another one.

        InputError where the frames are not connected, one of them moves in the other, or has two parents.
        """
        up, down = self.chain(frame), self.chain(world)
        common = next((name for name in up if name in down), None)
        if common is None:
            raise InputError(f"no transforms lead from frame {world!r} to {frame!r}")
        path = [*up[: up.index(common)], *down[: down.index(common)]]
        for name in path:
            edge = self.edges[name]
            if name in self.faults:
                raise InputError(self.faults[name])
            if not edge.still:
                raise InputError(
                    f"frame {frame!r} moves in {world!r}: {name!r} in {edge.parent!r} by {edge.moved:.3g} m and "
                    f"{math.degrees(edge.turned):.3g} degrees"
                )
        a, b = self._to(frame, common), self._to(world, common)
        return Placed(b.rotation.T @ a.rotation, b.rotation.T @ (a.translation - b.translation))

    def _to(self, frame: str, above: str) -> Placed:
        """The pose of a frame in one above it."""
        rotation, translation = np.eye(3), np.zeros(3)
        while frame != above:
            edge = self.edges[frame]
            rotation, translation = edge.rotation @ rotation, edge.rotation @ translation + edge.translation
            frame = edge.parent
        return Placed(rotation, translation)


def rotation_of(message: TransformMessage) -> Floats:
    """(3, 3) rotation of a unit quaternion (x, y, z, w); InputError for another length, or a place that is none."""
    if not np.isfinite(message.translation).all():
        raise InputError(f"transform of frame {message.child!r}: its translation is not finite")
    with np.errstate(over="ignore", invalid="ignore"):  # what is infinite, or no number, is refused
        length = float(np.linalg.norm(message.quaternion))
    if not abs(length - 1) <= UNIT_SLACK:
        raise InputError(
            f"transform of frame {message.child!r}: a quaternion of length {length:.4g}; it must be 1 to within "
            f"{UNIT_SLACK}"
        )
    x, y, z, w = message.quaternion / length
    # fmt: off
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])
    # fmt: on
