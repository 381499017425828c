"""Tracks of the whole recording: cut where they are doubtful, linked again, smoothed and interpolated.

Tracks are cut into tracklets where two people overlap most and at long gaps.  Each tracklet then continues at most one
other, such that the sum of the log likelihood ratios of the links is greatest: the tracks of least cost, found by one
assignment of ends to begins.  A link is weighed by motion, by appearance and by the length of the gap.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.assignment import maximum_weight_matching
from occlog.track.methods.jipda.association_features import log_ratio, similarity

from .config import SortConfig
from .encounters import MIN_PROBABILITY, tempered
from .filter import SIGMA_SIZE_RATE, SIGMA_STROLL, SIZE_NOISE_DENSITY, TAIL, match_probability
from .kernels.boxes import ASPECT, LOG_HEIGHT, MIN_ASPECT, X, boxes_of, overlaps, states_of
from .kernels.motion import smooth

CUT_OVERLAP = 0.3
"""Intersection over union of two people from which their identities are doubtful; both are cut at its maximum."""
SEPARATED_S = 0.5
"""Overlaps this far apart [s] are two encounters, and a gap of this length cuts a track."""
STROLLED = 0.3
"""Probability that a person has stopped or turned in a gap."""
GAP_S = 1.5
"""Time constant of the probability that a person is not detected for the length of a gap [s]."""
TRUSTED_BOXES = 3.0
"""Appearance counts half for a tracklet of this many boxes."""
ROUNDS = 3
"""Linking is repeated with the longer tracks, at most."""


@dataclass
class TrackBoxes:
    """Boxes of one track in time order.

    Attributes:
        frame: (k,) index of the frame among all of the camera.
        boxes: (k, 4) left, top, right, bottom [px].
        appearance: (k, K) appearance vectors; NaN: none.
        row: (k,) number of each box, no other box of the camera has it.
    """

    frame: Ints
    boxes: Floats
    appearance: Floats
    row: Ints

    def take(self, rows: slice) -> TrackBoxes:
        """Return the boxes selected by a slice."""
        return TrackBoxes(self.frame[rows], self.boxes[rows], self.appearance[rows], self.row[rows])


class Doubt(NamedTuple):
    """A link that may be wrong, or two links that may be exchanged, with the probability of the alternative.

    `row` is the number of the first box after the link, `other` that after the second link; -1 where a single link may
    be wrong because a new person may have come instead. `frame` is the index of the later one's frame.
    """

    row: int
    other: int
    frame: int
    probability: float


class SmoothedTrack(NamedTuple):
    """A track with a smoothed box in each of the n frames from its first to its last."""

    frame: Ints  # (n,) index of the frame
    boxes: Floats  # (n, 4)
    variance: Floats  # (n, 2) of the centre
    detected: Bools  # (n,) whether there is a box
    shown: Bools  # (n,) whether the position is good enough for a row


class Ends(NamedTuple):
    """Smoothed states at the first and last boxes of T tracklets, with mean appearances.

    A state has 4 coordinates (centre [px], ln of the height, width / height) with values and rates.
    """

    start: Floats  # (T,) [s]
    end: Floats  # (T,)
    first: tuple[Floats, Floats]  # (T, 4, 2) means and (T, 4, 3) covariances
    last: tuple[Floats, Floats]
    height: Floats  # (T,) median [px]
    appearance: Floats  # (T, K)
    boxes: Ints  # (T,) number of boxes


def linked(
    tracks: Sequence[TrackBoxes], times: Floats, config: SortConfig, similarities: Floats, area: float
) -> tuple[list[TrackBoxes], list[Doubt]]:
    """Cut tracks where they are doubtful, and link the tracklets; return the tracks and the doubtful links.

    The tracks returned are sorted by first frame; those with fewer boxes than `min_boxes` are dropped.

    Args:
        tracks: tracks of the filter.
        times: (F,) times of the frames [s].
        config: settings of the method.
        similarities: (2, 3) number, sum and sum of squares of appearance similarities of one person and of two people.
        area: area of the image [px^2].
    """
    parts = cut(tracks, times)
    doubts: list[Doubt] = []
    # Density of people who appear: as many as the filter has found, over the image and the time
    births = len(tracks) / (area * max(float(times[-1] - times[0]), 1.0)) if len(times) else 1.0
    for _ in range(ROUNDS):
        joined, found = _joined(parts, times, config, similarities, births)
        doubts += found
        if len(joined) == len(parts):
            break
        parts = joined
    return [each for each in parts if len(each.frame) >= config.min_boxes], doubts


def cut(tracks: Sequence[TrackBoxes], times: Floats) -> list[TrackBoxes]:
    """Return tracklets sorted by first frame: tracks cut where two overlap most, and at long gaps.

    `times` (F,) are the times of the camera's frames [s].
    """
    at: list[set[int]] = [set() for _ in tracks]
    for (a, b), seen in _encounters(tracks).items():
        frames = np.array(sorted(seen))
        for run in np.split(frames, np.flatnonzero(np.diff(times[frames]) > SEPARATED_S) + 1):
            nearest = max(run.tolist(), key=lambda f: seen[f])
            at[a].add(nearest)
            at[b].add(nearest)
    out: list[TrackBoxes] = []
    for track, cuts in zip(tracks, at, strict=True):
        long = np.diff(times[track.frame]) > SEPARATED_S
        long &= np.diff(track.frame) > 2
        met = np.zeros(len(long), dtype=np.bool_)
        for f in cuts:
            met |= (track.frame[:-1] <= f) & (track.frame[1:] > f)
        bounds = [0, *(np.flatnonzero(long | met) + 1).tolist(), len(track.frame)]
        out += [track.take(slice(first, stop)) for first, stop in pairwise(bounds)]
    return sorted(out, key=lambda each: int(each.frame[0]))


def _encounters(tracks: Sequence[TrackBoxes]) -> dict[tuple[int, int], dict[int, float]]:
    """Return the overlaps above `CUT_OVERLAP` (intersection over union), by pair of track indices and then by frame.

    Boxes are interpolated in gaps.
    """
    frames = [np.arange(each.frame[0], each.frame[-1] + 1) for each in tracks]
    if not frames:
        return {}
    filled = [
        np.column_stack([np.interp(f, each.frame, each.boxes[:, c]) for c in range(4)])
        for f, each in zip(frames, tracks, strict=True)
    ]
    who = np.repeat(np.arange(len(tracks)), [len(f) for f in frames])
    frame, box = np.concatenate(frames), np.concatenate(filled)
    order = np.argsort(frame, kind="stable")
    who, frame, box = who[order], frame[order], box[order]
    starts = [0, *(np.flatnonzero(np.diff(frame)) + 1).tolist(), len(frame)]
    found: dict[tuple[int, int], dict[int, float]] = {}
    for first, stop in pairwise(starts):
        shared = np.triu(overlaps(box[first:stop], box[first:stop]), 1)
        for i, j in zip(*np.nonzero(shared > CUT_OVERLAP), strict=True):
            pair = (int(who[first + i]), int(who[first + j]))
            found.setdefault(pair, {})[int(frame[first])] = float(shared[i, j])
    return found


def _smoothed(track: TrackBoxes, times: Floats, config: SortConfig, frames: Ints) -> tuple[Floats, Floats]:
    """Return smoothed means (n, 4, 2) and covariances (n, 4, 3) of a track at `frames` (n,), which include its own.

    A state has 4 coordinates (centre [px], ln of the height, width / height), each with value and rate.

    Args:
        track: boxes of the track.
        times: (F,) times of the camera's frames [s].
        config: settings of the method.
        frames: (n,) indices of the frames, increasing.
    """
    states = states_of(track.boxes)
    seen = np.isin(frames, track.frame)
    z, noise = np.zeros((len(frames), 4)), np.ones((len(frames), 4))
    z[seen] = states
    height = np.exp(states[:, LOG_HEIGHT])
    position = (config.sigma_position * height) ** 2
    size = np.full(len(height), config.sigma_size**2)
    noise[seen] = np.column_stack([position, position, size, size])
    scale = float(np.median(height)) ** 2
    density = np.array([config.process_noise_density * scale] * 2 + [SIZE_NOISE_DENSITY] * 2)
    speed = np.array([config.sigma_speed**2 * scale] * 2 + [SIGMA_SIZE_RATE**2] * 2)
    found: tuple[Floats, Floats] = smooth(times[frames], seen, z, noise, density, speed)
    return found


def _ends(parts: Sequence[TrackBoxes], times: Floats, config: SortConfig) -> Ends:
    """Return smoothed states at the first and last box of each tracklet; `times` (F,) are those of the frames [s]."""
    states = [_smoothed(each, times, config, each.frame) for each in parts]
    appearance = np.array([_mean(each.appearance) for each in parts])
    return Ends(
        start=np.array([times[each.frame[0]] for each in parts]),
        end=np.array([times[each.frame[-1]] for each in parts]),
        first=(np.array([mean[0] for mean, _ in states]), np.array([cov[0] for _, cov in states])),
        last=(np.array([mean[-1] for mean, _ in states]), np.array([cov[-1] for _, cov in states])),
        height=np.array([np.median(each.boxes[:, 3] - each.boxes[:, 1]) for each in parts]),
        appearance=appearance,
        boxes=np.array([len(each.frame) for each in parts]),
    )


def _mean(appearance: Floats) -> Floats:
    """Return the (K,) mean of the known rows of `appearance` (k, K); NaN if none is known."""
    known = appearance[~np.isnan(appearance).any(axis=1)]
    return known.mean(axis=0) if len(known) else np.full(appearance.shape[1], np.nan)


def _joined(
    parts: Sequence[TrackBoxes], times: Floats, config: SortConfig, similarities: Floats, births: float
) -> tuple[list[TrackBoxes], list[Doubt]]:
    """Link tracklets with the largest sum of log likelihood ratios; return the linked tracks and the doubtful links.

    Args:
        parts: tracklets.
        times: (F,) times of the frames [s].
        config: settings of the method.
        similarities: (2, 3) number, sum and sum of squares of appearance similarities of one person and of two people.
        births: number of people who appear per second and px^2.
    """
    if len(parts) < 2:
        return list(parts), []
    ends = _ends(parts, times, config)
    order = np.argsort(ends.start, kind="stable")
    rows, columns, weights = [], [], []
    for i in range(len(parts)):
        low, high = np.searchsorted(ends.start[order], [ends.end[i] + 1e-9, ends.end[i] + config.max_gap_s])
        after = order[low:high]
        if not len(after):
            continue
        weight = link_ratios(ends, i, after, config, similarities, births)
        good = weight > 0.0
        rows.append(np.full(int(good.sum()), i))
        columns.append(after[good])
        weights.append(weight[good])
    if not rows:
        return list(parts), []
    row, column, weight = np.concatenate(rows), np.concatenate(columns), np.concatenate(weights)
    made = maximum_weight_matching(row, column, weight)
    following = dict(zip(row[made].tolist(), column[made].tolist(), strict=True))
    ratios = dict(zip(zip(row.tolist(), column.tolist(), strict=True), weight.tolist(), strict=True))
    return _chains(parts, following), list(_doubts(parts, following, ratios))


def _doubts(
    parts: Sequence[TrackBoxes], following: dict[int, int], ratios: dict[tuple[int, int], float]
) -> Iterator[Doubt]:
    """Generate the links that may be wrong, and pairs of links that may be exchanged.

    Args:
        parts: tracklets.
        following: index of the next tracklet, for those that have one.
        ratios: log likelihood ratios of possible links, by both tracklets.
    """
    before = {after: first for first, after in following.items()}
    rivals: dict[int, list[int]] = {}
    for first, after in ratios:
        if after in before and following.get(first, after) != after:
            rivals.setdefault(first, []).append(after)
    for first, after in following.items():
        ratio = ratios[first, after]
        yield from _doubt(parts, after, None, ratio)
        for other in rivals.get(first, []):
            crossed = ratios.get((before[other], after))
            if other > after or crossed is None:
                # Where the other way round leaves one without a link, that one is of a new person
                loss = ratio + ratios[before[other], other] - ratios[first, other] - (crossed or 0.0)
                yield from _doubt(parts, after, other, loss)


def _doubt(parts: Sequence[TrackBoxes], after: int, other: int | None, loss: float) -> Iterator[Doubt]:
    """Generate the doubt about a link, or a pair of links, if the alternative has at least `MIN_PROBABILITY`.

    The alternative is that the link does not exist, or that the two links are exchanged.

    Args:
        parts: tracklets.
        after: index of the tracklet after the link.
        other: index of the tracklet after the other link; None: a single link.
        loss: log likelihood ratio by which the alternative is less likely.
    """
    probability = float(tempered(np.asarray(loss)))
    if probability >= MIN_PROBABILITY:
        frame = max(int(parts[k].frame[0]) for k in (after, after if other is None else other))
        yield Doubt(int(parts[after].row[0]), -1 if other is None else int(parts[other].row[0]), frame, probability)


def _chains(parts: Sequence[TrackBoxes], following: dict[int, int]) -> list[TrackBoxes]:
    """Return the sequences of linked tracklets as tracks, sorted by first frame.

    `following` has the index of the next tracklet, for those that have one.
    """
    continued = set(following.values())
    out = []
    for first in range(len(parts)):
        if first in continued:
            continue
        chain = [first]
        while chain[-1] in following:
            chain.append(following[chain[-1]])
        out.append(_one(parts[k] for k in chain))
    return sorted(out, key=lambda each: int(each.frame[0]))


def _one(parts: Iterable[TrackBoxes]) -> TrackBoxes:
    """Return the boxes of several tracklets as one, in their order."""
    some = list(parts)
    return TrackBoxes(
        *(np.concatenate([getattr(each, name) for each in some]) for name in ("frame", "boxes", "appearance", "row"))
    )


def link_ratios(ends: Ends, i: int, after: Ints, config: SortConfig, similarities: Floats, births: float) -> Floats:
    """Return (n,) log likelihood ratios of the hypotheses that a tracklet continues tracklet `i`, or is a new person's.

    The person went on along the predicted path, or has stopped or turned in the gap; appearance and length of the gap
    count, too.

    Args:
        ends: smoothed ends of all tracklets.
        i: index of the first tracklet.
        after: (n,) indices of the tracklets that may follow.
        config: settings of the method.
        similarities: (2, 3) number, sum and sum of squares of appearance similarities of one person and of two people.
        births: number of people who appear per second and px^2.
    """
    gap = (ends.start[after] - ends.end[i])[:, None]
    mean, cov = ends.last[0][i], ends.last[1][i]
    to, to_cov = ends.first[0][after], ends.first[1][after]
    height = ends.height[i]
    density = np.array([config.process_noise_density * height**2] * 2 + [SIZE_NOISE_DENSITY])
    ahead = mean[:3, 0] + gap * mean[:3, 1]
    spread = cov[:3, 0] + 2.0 * gap * cov[:3, 1] + gap**2 * cov[:3, 2] + density * gap**3 / 3.0 + to_cov[:, :3, 0]
    went = _log_t(to[:, :3, 0] - ahead, spread)
    # Velocities agree better than those of two arbitrary people
    drift = cov[:2, 2] + to_cov[:, :2, 2] + density[:2] * gap
    arbitrary = 2.0 * (config.sigma_speed * height) ** 2
    off = to[:, :2, 1] - mean[:2, 1]
    went += (-0.5 * off**2 / drift - 0.5 * np.log(drift / arbitrary)).sum(axis=1)
    stroll = np.column_stack([(SIGMA_STROLL * height) ** 2 * gap] * 2 + [np.full(len(after), SIGMA_SIZE_RATE**2)])
    turned = _log_t(to[:, :3, 0] - mean[:3, 0], stroll + cov[:3, 0] + to_cov[:, :3, 0])
    out = np.logaddexp(went + np.log(1.0 - STROLLED), turned + np.log(STROLLED))
    if ends.appearance.shape[1]:
        like = similarity(ends.appearance[i : i + 1], ends.appearance[after])[0]
        boxes = np.minimum(ends.boxes[i], ends.boxes[after])
        out += log_ratio(similarities, like) * boxes / (boxes + TRUSTED_BOXES) * 2.0
    out += -gap[:, 0] / GAP_S - np.log(births)
    return np.asarray(out)


def _log_t(off: Floats, spread: Floats) -> Floats:
    """Return (n,) Student t log densities of differences `off` (n, 3) of centre [px] and ln height.

    `spread` (n, 3) are the variances. The size counts in the distance only, not in the normalisation.
    """
    distance = (off * off / spread).sum(axis=1)
    return np.asarray(
        -0.5 * (TAIL + 3.0) * np.log1p(distance / TAIL) - 0.5 * np.log(spread[:, :2]).sum(axis=1) - np.log(2.0 * np.pi)
    )


def smoothed_track(track: TrackBoxes, times: Floats, config: SortConfig) -> SmoothedTrack:
    """Return a track smoothed and interpolated in all frames from its first to its last box.

    `times` (F,) are the times of the camera's frames [s].
    """
    frames = np.arange(track.frame[0], track.frame[-1] + 1)
    mean, cov = _smoothed(track, times, config, frames)
    detected = np.isin(frames, track.frame)
    width = np.exp(mean[:, LOG_HEIGHT, 0]) * np.maximum(mean[:, ASPECT, 0], MIN_ASPECT)
    sure = match_probability(width, cov[:, X, 0]) > config.min_match_probability
    return SmoothedTrack(frames, boxes_of(mean[..., 0]), cov[:, :2, 0], detected, detected | sure)
