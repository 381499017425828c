"""From moments of looks to tables of everybody, a part at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Generic, NamedTuple, TypeVar

from occlog.records.scene import Camera, Scene
from occlog.track.jipda.config import JipdaConfig
from occlog.track.jipda.interface import Look, Moment

from .agreement import Agreement
from .looks import FrameLook
from .rows import EverybodyInViews, MomentTables, SeenMoment, events_of, support_of, tracks_of

State = TypeVar("State")
MOMENTS_PER_PART = 256


class Follower(NamedTuple, Generic[State]):
    """A method that follows everybody: `begin` makes its state, `step` takes the looks of one moment in."""

    begin: Callable[[Scene, Sequence[Camera], JipdaConfig], State]
    step: Callable[[State, Sequence[Look]], tuple[State, Moment]]


def follow(
    moments: Iterable[Sequence[FrameLook]],
    scene: Scene,
    cameras: Sequence[Camera],
    config: JipdaConfig,
    follower: Follower[State],
) -> Iterator[list[SeenMoment]]:
    """Follow everybody; some moments at a time, so that memory does not grow with their number.

    Args:
        moments: in the order of time; none is empty.
        scene: where.
        cameras: those that look, in the order of their places in the looks.
        config: settings.
        follower: the method.
    """
    state = follower.begin(scene, cameras, config)
    held: list[SeenMoment] = []
    for looks in moments:
        state, moment = follower.step(state, [each.look for each in looks])
        held.append(SeenMoment(moment, looks))
        if len(held) >= MOMENTS_PER_PART:
            yield held
            held = []
    if held:
        yield held


class Tabulator:
    """Makes tables of moments, and counts whom the cameras see."""

    def __init__(self, cameras: Sequence[Camera], *, in_images: bool) -> None:
        """Nothing was seen yet; `in_images` says whether everybody in every image is wanted."""
        self._names = [c.name for c in cameras]
        self._views = EverybodyInViews(cameras) if in_images else None
        self.agreement = Agreement(self._names)

    def tables(self, seen: Sequence[SeenMoment]) -> MomentTables:
        """The rows of some moments."""
        for each in seen:
            self.agreement.add(each.moment, each.looks)
        return MomentTables(
            tracks=tracks_of(seen, self._names),
            support=support_of(seen, self._names),
            events=events_of(seen),
            views=None if self._views is None else self._views.table(seen),
        )
