"""Fusion of tracks of several groups of cameras: one identity and one state per person.

The tracks of all groups are resampled to common time steps. Groups are then added one after the other: tracks of one
person are matched, their states are fused by covariance intersection, since groups have common errors (motion model,
cameras, poses), and identities continue from track to track.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints, Ints32, Strings
from occlog.errors import InputError
from occlog.records.declared.people import (
    COASTING,
    INCONSISTENT_VIEWS,
    POSSIBLE_SWITCH,
    SINGLE_VIEW,
    has_word,
    words_of,
)
from occlog.records.tables import Events, JoinedTracks, PeopleTracks

from .config import TrackFusionConfig
from .match import NO_ID, GroundPositions, IdentityMatcher, distances, intersect, match_tracks

JUST_UNDER = 0.49
"""Time steps are so much of the shortest period long, so that none has two rows of one track."""
STRAIGHT = (
    *("x", "y", "vx", "vy", "cov_xx", "cov_xy", "cov_yy", "cov_x_vx", "cov_x_vy", "cov_y_vx", "cov_y_vy"),
    *("cov_vx_vx", "cov_vx_vy", "cov_vy_vy", "existence_probability", "height", "width", "sd_height", "sd_width"),
)
"""Columns that a straight line bridges.  The covariance of a position on the line is at most that of its ends in that
shares, whatever their errors have in common."""


def default_window(groups: Sequence[PeopleTracks]) -> int:
    """Default window [ns] for common time steps: `JUST_UNDER` times the shortest median period of all groups.

    0 if no group has two times.
    """
    periods = [np.median(np.diff(times)) for g in groups if len(times := np.unique(g.t_ns)) > 1]
    return int(JUST_UNDER * min(periods)) if periods else 0


def step_times(groups: Sequence[PeopleTracks], window_ns: int) -> Ints:
    """(T,) common time steps [ns] of all groups: rising; each is the first time after the window of the one before.

    Times at most `window_ns` [ns] after a time step belong to it.
    """
    times = np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *(g.t_ns for g in groups)]))
    starts: list[int] = []
    at = 0
    while at < len(times):
        starts.append(int(times[at]))
        at = int(np.searchsorted(times, times[at] + window_ns, side="right"))
    return np.array(starts, dtype=np.int64)


def at_times(tracks: PeopleTracks, times: Ints, window_ns: int, gap_ns: int) -> PeopleTracks:
    """Resample all tracks to the time steps `times` (T,) [ns]; rows sorted by time and identity.

    A row at a time step is unchanged. Between rows at most `gap_ns` [ns] apart states are interpolated linearly;
    otherwise the nearest row at most `window_ns` [ns] from a time step is moved there with its velocity.
    """
    order = np.lexsort((tracks.t_ns, tracks.target_id))
    starts = np.flatnonzero(np.diff(tracks.target_id[order], prepend=-1)) if len(order) else np.zeros(0, dtype=np.int64)
    parts = [
        _one_at_times(tracks.take(rows), times, window_ns, gap_ns) for rows in np.split(order, starts[1:]) if len(rows)
    ]
    return PeopleTracks.merge(parts)


def _one_at_times(track: PeopleTracks, times: Ints, window_ns: int, gap_ns: int) -> PeopleTracks:
    t = track.t_ns
    asked = times[np.searchsorted(times, t[0] - window_ns) : np.searchsorted(times, t[-1] + window_ns, "right")]
    # The rows before and after each time step; at the ends of the track the same row twice
    before = np.clip(np.searchsorted(t, asked, side="right") - 1, 0, len(t) - 1)
    after = np.clip(np.searchsorted(t, asked, side="left"), 0, len(t) - 1)
    nearest = np.where(asked - t[before] <= t[after] - asked, before, after)
    inside = (t[before] <= asked) & (asked <= t[after]) & (t[after] - t[before] <= gap_ns)
    good = inside | (np.abs(asked - t[nearest]) <= window_ns)
    before, after = np.where(inside, before, nearest)[good], np.where(inside, after, nearest)[good]
    asked, nearest = asked[good], nearest[good]
    # Interpolate; outside of lines, move on with the velocity
    share = (asked - t[before]) / np.maximum(t[after] - t[before], 1)
    share[before == after] = 0.0
    delay = np.where(before == after, (asked - t[before]) / NS, 0.0)
    values = {name: _line(getattr(track, name), before, after, share) for name in STRAIGHT}
    for coordinate, speed in (("x", "vx"), ("y", "vy")):
        values[coordinate] = values[coordinate] + np.where(np.isfinite(values[speed]), delay * values[speed], 0.0)
    columns = {c.name: getattr(track, c.name)[nearest] for c in PeopleTracks.columns()}
    return PeopleTracks(**{**columns, **values, "t_ns": asked})


def _line(values: Floats, before: Ints, after: Ints, share: Floats) -> Floats:
    """(T, ...) linear interpolation between the entries `before` and `after` (T,) of `values` (n, ...).

    `share` (T,) is the position between both, 0 to 1. Where `before` equals `after` the entry itself is returned.
    """
    same = before == after
    between: Floats = (1.0 - share) * values[before] + share * values[after]
    return np.where(same, values[before], between)


STATE = ("x", "y", "vx", "vy")
COVARIANCE = (
    ("cov_xx", "cov_xy", "cov_x_vx", "cov_x_vy"),
    ("cov_xy", "cov_yy", "cov_y_vx", "cov_y_vy"),
    ("cov_x_vx", "cov_y_vx", "cov_vx_vx", "cov_vx_vy"),
    ("cov_x_vy", "cov_y_vy", "cov_vx_vy", "cov_vy_vy"),
)
"""Columns of the state and of its covariance."""
DOUBTS = (COASTING, SINGLE_VIEW, POSSIBLE_SWITCH, INCONSISTENT_VIEWS)
"""Values of the column `quality_flags`, in their order."""
NOT_THERE = "-"


class GroupConsistency(NamedTuple):
    """Agreement of a group of cameras with the groups before it.

    `n_common`: time steps at which both have a person. `pairs`: rows of one person matched at them. `offset`: mean
    x and y of the later group's position minus the earlier one. `distance`: median distance of matched positions
    [length]. Both are NaN without pairs.
    """

    n_common: int  # at which both have a person
    pairs: int  # rows of one person, at these time steps
    offset: tuple[float, float]  # mean of the later group's position minus that of those before; NaN without pairs
    distance: float  # median distance; NaN without pairs


class FusedGroupTracks(NamedTuple):
    """Tracks of all people fused over all groups of cameras, their events, and the agreement of each later group."""

    tracks: JoinedTracks
    events: Events
    agreements: list[GroupConsistency]  # of each group but the first one


class _Doubt(NamedTuple):
    t_ns: int
    identity: int
    other: int


def fuse_tracks(groups: Sequence[PeopleTracks], config: TrackFusionConfig) -> FusedGroupTracks:
    """Fuse the tracks of several groups of cameras by covariance intersection, with one identity per person.

    Groups are added one after the other, in the given order.

    Args:
        groups: tracks on the ground in one world frame; their times may differ.
        config: settings in the scene's unit.

    Raises:
        InputError: a track has heights (column z), which cannot be fused.
    """
    for group in groups:
        if np.isfinite(group.z).any():
            raise InputError(
                "tracks with heights (column z) cannot be fused; give tracks on the ground", id="not-applicable"
            )
    window_ns = default_window(groups) if config.window_s is None else round(config.window_s * 1e9)
    times = step_times(groups, window_ns)
    first, *later = (at_times(group, times, window_ns, round(config.max_gap_s * 1e9)) for group in groups)
    joined, doubts, agreements = _alone(first), list[_Doubt](), list[GroupConsistency]()
    for number, second in enumerate(later, start=1):
        after, more, agreement = _join(joined, second, number, config)
        doubts = [*_renamed(doubts, joined, after), *more]
        joined = after
        agreements.append(agreement)
    return FusedGroupTracks(joined, _events(joined, doubts, times), agreements)


def _alone(tracks: PeopleTracks) -> JoinedTracks:
    """Convert the tracks of one group to fused tracks: identities are kept, `source_ids` are the identities as text."""
    columns = {c.name: getattr(tracks, c.name) for c in PeopleTracks.columns()}
    return JoinedTracks(**columns, source_ids=tracks.target_id.astype(np.str_))


def _join(
    first: JoinedTracks, second: PeopleTracks, number: int, config: TrackFusionConfig
) -> tuple[JoinedTracks, list[_Doubt], GroupConsistency]:
    """Add the tracks of one more group of cameras to those fused before, at common time steps.

    Args:
        first: fused tracks of the groups before.
        second: tracks of the group.
        number: number of groups fused before, for the column `source_ids`.
        config: settings of the fusion.

    Returns:
        The fused tracks sorted by time and identity, the possible identity switches, and how well the group agrees with
        those before.
    """
    partner = match_tracks(first, second, config.sigma_registration, config.gate, config.comparison_window_s)
    pairs = np.flatnonzero(partner >= 0)
    mine, theirs = first.take(pairs), second.take(partner[pairs])
    left = np.setdiff1d(np.arange(len(second)), partner[pairs])
    there, nothing = second.target_id.astype(np.str_), ",".join([NOT_THERE] * number)
    lone_first, lone_second = first.take(partner < 0), _alone(second.take(left))
    parts = [
        replace(_fuse_matched(mine, theirs, config), source_ids=_with(mine.source_ids, there[partner[pairs]])),
        replace(lone_first, source_ids=_with(lone_first.source_ids, np.full(len(lone_first), NOT_THERE))),
        replace(lone_second, source_ids=_with(np.full(len(left), nothing), there[left])),
    ]
    # Identities: each row is a set of tracks
    here, also = np.full(len(first) + len(left), -1), np.full(len(first) + len(left), -1)
    here[: len(pairs)], also[: len(pairs)] = mine.target_id, theirs.target_id
    here[len(pairs) : len(first)] = lone_first.target_id
    also[len(first) :] = second.target_id[left]
    # People of the first group come first, so that they have the lower identities
    order = np.lexsort([also, here, here < 0, np.concatenate([part.t_ns for part in parts])])
    columns = {c.name: np.concatenate([getattr(p, c.name) for p in parts])[order] for c in JoinedTracks.columns()}
    rows, here, also = JoinedTracks(**columns), here[order], also[order]
    identity, doubts, exchanged = _identities(rows.t_ns, here, also)
    doubted = words_of(
        np.column_stack([has_word(rows.quality_flags, word) for word in DOUBTS])
        | _keep_flags(POSSIBLE_SWITCH, exchanged),
        DOUBTS,
    )
    rows = replace(rows, target_id=identity, quality_flags=doubted).sorted()
    return rows, doubts, _agreement(first, second, mine, theirs)


def _identities(t_ns: Ints, here: Ints, also: Ints) -> tuple[Ints32, list[_Doubt], Bools]:
    """Assign one identity to each of n fused rows, in the order of time, by the tracks of which they are made.

    Args:
        t_ns: (n,) nondecreasing times [ns].
        here: (n,) identities among the tracks fused before; -1: none.
        also: (n,) identities in the new group; -1: none.

    Returns:
        (n,) identities; the possible identity switches; (n,) mask of rows of an identity with a switch at that time.
    """
    identities, doubts = IdentityMatcher(), list[_Doubt]()
    out: Ints32 = np.zeros(len(t_ns), dtype=np.int32)
    exchanged: Bools = np.zeros(len(t_ns), dtype=np.bool_)
    for part in np.split(np.arange(len(t_ns)), np.flatnonzero(np.diff(t_ns)) + 1):
        people = [
            tuple((g, i) for g, i in enumerate(both) if i >= 0)
            for both in zip(here[part].tolist(), also[part].tolist(), strict=True)
        ]
        out[part] = identities.step(people)
        for identity, other in identities.doubts:
            doubts.append(_Doubt(int(t_ns[part[0]]), identity, other))
            exchanged[part[out[part] == identity]] = True
    return out, doubts, exchanged


def _fuse_matched(mine: JoinedTracks, theirs: PeopleTracks, config: TrackFusionConfig) -> JoinedTracks:
    """Fuse pairs of rows of two groups: row k of `mine` and of `theirs` are of one person and time.

    States by covariance intersection (the position alone where the covariance of the velocity is unknown), height and
    width from the more certain group, the larger existence probability, the union of the cameras, and flags of either;
    `coasting` only if both have it. `inconsistent_views` is added where positions are beyond the gate.
    """
    n = len(mine)
    known = np.isfinite(_covariances(mine)).all(axis=(1, 2)) & np.isfinite(_covariances(theirs)).all(axis=(1, 2))
    mean, covariance = np.full((n, 4), np.nan), np.full((n, 4, 4), np.nan)
    for size, rows in ((4, np.flatnonzero(known)), (2, np.flatnonzero(~known))):
        means = _means(mine)[rows, :size], _means(theirs)[rows, :size]
        spreads = _covariances(mine)[rows, :size, :size], _covariances(theirs)[rows, :size, :size]
        mean[rows, :size], covariance[rows, :size, :size] = intersect(means, spreads)
    values: dict[str, Floats] = {name: mean[:, i] for i, name in enumerate(STATE)}
    values |= {name: covariance[:, i, j] for i, row in enumerate(COVARIANCE) for j, name in enumerate(row) if i <= j}
    # Covariance intersection of single numbers takes the more certain one
    for name in ("height", "width"):
        a, b = getattr(mine, f"sd_{name}"), getattr(theirs, f"sd_{name}")
        less = ~(b >= a)
        values[name] = np.where(less, getattr(theirs, name), getattr(mine, name))
        values[f"sd_{name}"] = np.where(less, b, a)
    values["existence_probability"] = np.fmax(mine.existence_probability, theirs.existence_probability)
    seen_by = [_united(a, b) for a, b in zip(mine.seen_by.tolist(), theirs.seen_by.tolist(), strict=True)]
    too_far = (
        distances(GroundPositions.of(mine), GroundPositions.of(theirs), config.sigma_registration) > config.gate**2
    )
    one = np.array([bool(text) and "," not in text for text in seen_by], dtype=np.bool_)
    doubted = np.column_stack(
        [
            has_word(mine.quality_flags, COASTING) & has_word(theirs.quality_flags, COASTING),
            one & (has_word(mine.quality_flags, SINGLE_VIEW) | has_word(theirs.quality_flags, SINGLE_VIEW)),
            has_word(mine.quality_flags, POSSIBLE_SWITCH) | has_word(theirs.quality_flags, POSSIBLE_SWITCH),
            has_word(mine.quality_flags, INCONSISTENT_VIEWS) | too_far,
        ]
    )
    return mine.with_columns(
        **values, seen_by=np.array(seen_by, dtype=np.str_), quality_flags=words_of(doubted, DOUBTS)
    )


def _means(tracks: PeopleTracks) -> Floats:
    return np.column_stack([getattr(tracks, name) for name in STATE])


def _covariances(tracks: PeopleTracks) -> Floats:
    """(n, 4, 4) covariances of the states x, y, vx, vy, from the columns of the table."""
    return np.stack([np.column_stack([getattr(tracks, name) for name in row]) for row in COVARIANCE], axis=1)


def _united(first: str, second: str) -> str:
    """Union of two comma-separated lists of names: those of `first`, then the others of `second`; no empty ones."""
    return ",".join(dict.fromkeys(name for text in (first, second) for name in text.split(",") if name))


def _keep_flags(word: str, where: Bools) -> Bools:
    """(n, W) mask of W quality flags: True in the column of `word` for the rows selected by `where` (n,)."""
    mask: Bools = where[:, None] & (np.array(DOUBTS) == word)
    return mask


def _with(texts: Strings, more: Strings) -> Strings:
    """Append one word to each comma-separated list: `texts` and `more` are (n,)."""
    return np.array([f"{a},{b}" for a, b in zip(texts.tolist(), more.tolist(), strict=True)], dtype=np.str_)


def _agreement(first: PeopleTracks, second: PeopleTracks, mine: PeopleTracks, theirs: PeopleTracks) -> GroupConsistency:
    n_common = len(np.intersect1d(first.t_ns, second.t_ns))
    if not len(mine):
        return GroupConsistency(n_common, 0, (np.nan, np.nan), np.nan)
    dx, dy = theirs.x - mine.x, theirs.y - mine.y
    return GroupConsistency(
        n_common, len(mine), (float(dx.mean()), float(dy.mean())), float(np.median(np.hypot(dx, dy)))
    )


def _renamed(doubts: list[_Doubt], before: JoinedTracks, after: JoinedTracks) -> list[_Doubt]:
    """Rename the identities in possible switches after one more group was added.

    Args:
        doubts: possible switches with identities of `before`.
        before: fused tracks without the new group.
        after: fused tracks with it, at the same times.
    """
    named: dict[int, tuple[Ints, Ints]] = {}
    groups = before.source_ids[0].count(",") + 1 if len(before) else 0
    keys = np.array([text.rsplit(",", 1)[0] for text in after.source_ids.tolist()], dtype=np.str_)
    now = dict(zip(zip(after.t_ns.tolist(), keys.tolist(), strict=True), after.target_id.tolist(), strict=True))
    if not groups:
        return []
    for identity in {i for d in doubts for i in (d.identity, d.other)}:
        rows = before.take(before.target_id == identity)
        ids = [now[key] for key in zip(rows.t_ns.tolist(), rows.source_ids.tolist(), strict=True)]
        named[identity] = rows.t_ns, np.array(ids, dtype=np.int64)

    def name(identity: int, t_ns: int) -> int:
        times, ids = named[identity]
        return int(ids[max(int(np.searchsorted(times, t_ns, side="right")) - 1, 0)])

    return [_Doubt(d.t_ns, name(d.identity, d.t_ns), name(d.other, d.t_ns)) for d in doubts]


def _events(tracks: JoinedTracks, doubts: list[_Doubt], times: Ints) -> Events:
    """Build the events: initiations (first row of an identity), terminations (time step after its last), switches.

    An identity that lasts to the last time step has no termination. `doubts` are the possible switches, `times`
    (T,) all time steps [ns].
    """
    ids, first = np.unique(tracks.target_id, return_index=True)
    last = len(tracks) - 1 - np.unique(tracks.target_id[::-1], return_index=True)[1]
    ended = np.searchsorted(times, tracks.t_ns[last], side="right")
    gone = ended < len(times)
    births = [
        (int(tracks.t_ns[row]), "initiated", int(i), NO_ID, float(tracks.existence_probability[row]))
        for i, row in zip(ids, first, strict=True)
    ]
    deaths = [
        (int(times[end]), "terminated", int(i), NO_ID, float(tracks.existence_probability[row]))
        for i, end, row in zip(ids[gone], ended[gone], last[gone], strict=True)
    ]
    doubtful = [(d.t_ns, "possible_switch", d.identity, d.other, np.nan) for d in doubts]
    return Events.of_rows([*births, *deaths, *doubtful])
