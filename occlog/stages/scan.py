"""Rows of bearings to scans: what all sensors say about a target at one time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import pairwise

import numpy as np

from ..columns import Ints
from ..errors import InputError, UsageError
from ..records import UNLABELLED, Bearings
from ..scene import Scene
from ..trackers.method import Scan, sensor_names


@dataclass(frozen=True)
class Choice:
    """Which rows a tracker gets to see, and which of them count as simultaneous."""

    sensors: tuple[str, ...] | None = None  # None: all of the scene
    without: tuple[str, ...] = ()  # left out of them
    targets: tuple[int, ...] | None = None  # None: all
    unlabelled: bool = True  # use candidates that are not assigned to a target
    group_s: float = 0.0  # rows this close to the first of a scan belong to it, at its time

    def __post_init__(self) -> None:
        if not 0.0 <= self.group_s < 3600.0:
            raise UsageError(f"track: group_s is {self.group_s}, must be in [0, 3600) s")
        if self.targets is not None and (not self.targets or min(self.targets) < 0):
            raise UsageError(f"track: targets {self.targets} must be numbers from 0")


def choose_sensors(scene: Scene, choice: Choice) -> tuple[str, ...]:
    """Names of the sensors to use, in the order of the scene; UsageError for a name that the scene does not have."""
    names = sensor_names(scene)
    for name in (*(choice.sensors or ()), *choice.without):
        if name not in names:
            near = get_close_matches(name, names, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"the scene has: {', '.join(names) or 'none'}"
            raise UsageError(f"no sensor named {name!r}; {hint}")
    wanted = names if choice.sensors is None else choice.sensors
    used = tuple(n for n in names if n in wanted and n not in choice.without)
    if not used:
        raise UsageError("no sensor is left to track with; name fewer in --without")
    return used


@dataclass(frozen=True, eq=False)
class Group:
    """Rows that belong to one time: all targets, all sensors."""

    t_ns: int
    rows: Bearings
    sensor: Ints  # (R,) place in `sensor_names`

    def targets(self) -> list[int]:
        """Identities of the labelled rows, rising."""
        return [k for k in np.unique(self.rows.target_id).tolist() if k != UNLABELLED]

    def scan(self, target: int) -> Scan | None:
        """What concerns a target: its own rows, and candidates of sensors that have no row for it; None: nothing."""
        ids = self.rows.target_id
        own = ids == target
        use = own | ((ids == UNLABELLED) & ~np.isin(self.sensor, self.sensor[own]))
        at = np.flatnonzero(use)
        if not len(at):
            return None
        at = at[np.argsort(self.sensor[at], kind="stable")]
        r = self.rows
        return Scan(
            self.t_ns, self.sensor[at], own[at], r.seen[at], r.bearing[at], r.sigma[at],
            r.u_px[at], r.sigma_px[at], r.score[at],
        )  # fmt: skip


def groups(chunks: Iterable[Bearings], scene: Scene, choice: Choice) -> Iterator[list[Group]]:
    """The chosen rows, grouped by time; one list for every chunk, independent of where chunks are cut.

    InputError for a sensor that the scene does not have or that has no pose, for times that
    go back from one chunk to the next, and for a sensor that reports a target twice at one time.
    """
    names = sensor_names(scene)
    place = {name: i for i, name in enumerate(names)}
    used = choose_sensors(scene, choice)
    unplaced = {c.name for c in scene.cameras if not c.placed}
    carry, last_ns, count = Bearings.empty(), None, 0
    for chunk in chunks:
        if not len(chunk):
            continue
        _check_sensors(chunk, names, unplaced & set(used), count)
        if last_ns is not None and chunk.t_ns[0] < last_ns:
            raise InputError(
                f"bearings: row {count}: t_ns goes back from {last_ns} to {chunk.t_ns[0]} "
                f"(sensor {str(chunk.sensor[0])!r}); sort by time"
            )
        last_ns, count = int(chunk.t_ns[-1]), count + len(chunk)
        rows = Bearings.concat([carry, _chosen(chunk, used, choice)])
        cuts = _cuts(rows, round(choice.group_s * 1e9))
        # The last group may go on in the next chunk.
        yield [_group(rows.take(slice(a, b)), place) for a, b in pairwise(cuts[:-1])]
        carry = rows.take(slice(cuts[-2], None)) if len(rows) else rows
    if len(carry):
        yield [_group(carry, place)]


def _check_sensors(chunk: Bearings, names: Sequence[str], unplaced: set[str], offset: int) -> None:
    found, first = np.unique(chunk.sensor, return_index=True)
    for name, row in zip(found.tolist(), first.tolist(), strict=True):
        if name not in names:
            near = get_close_matches(name, names, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"the scene has: {', '.join(names) or 'none'}"
            raise InputError(f"bearings: row {row + offset}: the scene has no sensor {name!r}; {hint}")
        if name in unplaced:
            raise InputError(
                f"bearings: row {row + offset}: camera {name!r} has no pose in the scene; "
                f"add its position and yaw, or leave it out (--without {name})"
            )


def _chosen(chunk: Bearings, used: Sequence[str], choice: Choice) -> Bearings:
    keep = np.isin(chunk.sensor, used)
    if choice.targets is not None:
        keep &= np.isin(chunk.target_id, (*choice.targets, UNLABELLED))
    if not choice.unlabelled:
        keep &= chunk.target_id != UNLABELLED
    return chunk if keep.all() else chunk.take(keep)


def _cuts(rows: Bearings, width_ns: int) -> list[int]:
    """Row numbers at which groups begin, and the end; at least two unless there are no rows."""
    t_ns, n = rows.t_ns, len(rows)
    if not n:
        return [0, 0]
    if not width_ns:
        return [0, *(np.flatnonzero(np.diff(t_ns)) + 1).tolist(), n]
    cuts = [0]
    while cuts[-1] < n:
        start = cuts[-1]
        end = int(np.searchsorted(t_ns, t_ns[start] + width_ns, side="right"))
        cuts.append(_before_repeat(rows, start, end))
    return cuts


def _before_repeat(rows: Bearings, start: int, end: int) -> int:
    """The end of a group, earlier if a sensor has a second frame in it."""
    frames: dict[tuple[str, int], int] = {}
    for row in range(start, end):
        key = (str(rows.sensor[row]), int(rows.target_id[row]))
        if frames.setdefault(key, int(rows.t_ns[row])) != rows.t_ns[row]:
            # All rows of that time go to the next group.
            return int(np.searchsorted(rows.t_ns, rows.t_ns[row], side="left"))
    return end


def _group(rows: Bearings, place: dict[str, int]) -> Group:
    sensor = np.array([place[name] for name in rows.sensor.tolist()], dtype=np.int64)
    order = np.lexsort((rows.target_id, sensor))
    twice = (np.diff(sensor[order]) == 0) & (np.diff(rows.target_id[order]) == 0)
    twice &= rows.target_id[order][1:] != UNLABELLED
    if twice.any():
        row = int(order[1:][twice][0])
        raise InputError(
            f"bearings: sensor {str(rows.sensor[row])!r} reports target {rows.target_id[row]} twice at "
            f"t_ns {rows.t_ns[row]}; keep one row for each sensor, target and time"
        )
    return Group(int(rows.t_ns[0]), rows, sensor)
