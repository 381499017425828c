"""Bearings to tracks, streaming: the kinds of methods and what they have in common."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from occlog.errors import UsageError
from occlog.measure.scans.scan import sensor_names
from occlog.measure.scans.scans import Rows
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Hulls, Occluders
from occlog.track.apf.selection_policies import SelectConfig
from occlog.track.catalogue import tracker
from occlog.track.interface import Batch, Online

from .batch import track_batch
from .joint import track_joint
from .online import track_online
from .rows import Tracked


def track(
    bearings: Iterable[Bearings],
    scene: Scene,
    config: Any,
    seed: int,
    *,
    method: str = "apf",
    sensors: frozenset[str] | None = None,
    targets: tuple[int, ...] | None = None,
    unlabelled: bool = True,
    window_ns: int = 0,
    occluders: Iterable[Occluders] | Iterable[Hulls] | None = None,
    selection: SelectConfig | None = None,
) -> Iterator[Tracked]:
    """Tracks of all targets, chunk by chunk, in the order of time; memory does not grow with their length.

    Each labelled target has a filter of its own, with its own random numbers, which starts
    with the target's first row; what one target's track is does not depend on the others.
    Unlabelled candidates go to every filter, but not for a sensor that has a labelled row
    for that target.  If no target was met before they start a track themselves, numbered by
    the first of `targets`, or 0.

    Args:
        bearings: chunks in the order of time; where they are cut does not matter.
        scene: the sensors, the room and what stands in it.
        config: settings of the method, see `occlog.track.catalogue`.
        seed: of all random numbers.
        method: a key of `TRACKERS`.
        sensors: names of those to use; None: all.
        targets: identities of those to track; None: all.
        unlabelled: use candidates that are not assigned to a target.
        window_ns: rows at most this far apart form one scan.
        occluders: priors of the moving occluders, in the order of time; None: nothing is known about them.
        selection: how to select cameras; only those selected are used.  None: no selection.

    Raises:
        InputError: bearings that do not fit the scene or each other.
        UsageError: a start (`config.start`) for several targets, or a selection that the
            method or the scene does not allow.
    """
    chosen = tracker(method)
    use = Rows(frozenset(sensor_names(scene)) if sensors is None else sensors, targets, unlabelled)
    if isinstance(chosen, Online):
        if occluders is not None and not hasattr(config, "occluder_diameter"):
            raise UsageError(f"--occluders: method {method} knows nothing of moving occluders; leave --occluders out")
        yield from track_online(bearings, scene, config, chosen, seed, use, window_ns, occluders, selection)
        return
    how = "takes all that was recorded at once" if isinstance(chosen, Batch) else "asks cameras itself (--cooperate)"
    for given, option in ((selection, "--select"), (occluders, "--occluders")):
        if given is not None:
            raise UsageError(f"{option}: method {method} {how}; leave {option} out")
    if isinstance(chosen, Batch):
        yield from track_batch(bearings, scene, config, chosen, use, window_ns)
    else:
        yield from track_joint(bearings, scene, config, chosen, seed, use, window_ns)
