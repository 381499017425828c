"""Tracks of many targets in images against true boxes: failure rates of [Qu], CLEAR-MOT, IDF1, HOTA and GOSPA.

Which target is a track's own: the one of its number, the first one it is on, or the one it is on most.
`on_ground` compares tracks on the ground, with the same figures and more.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from occlog.array_types import Floats, Ints, Strings
from occlog.core.metrics import failure_rates
from occlog.core.metrics.failure_rates import NONE
from occlog.core.metrics.frame_pairs import Objects, of_boxes, of_points
from occlog.evaluate.stage import Evaluation
from occlog.records.views import Failures

from .config import ManyConfig
from .figures import Metrics, across_views, centres, failure_figures, gospa_figures, mot_figures, of_view
from .truth_and_tracks import TruthAndTracks


class NearPairs(NamedTuple):
    """Pairs of a track's row and a true row that are near each other in a frame."""

    truth: Ints
    track: Ints
    share: Floats  # distance over tau


def own_targets(truth: Objects, tracks: Objects, tau: Floats, t_ns: Ints, how: str) -> Ints:
    """(m,) label of the target that each row's track belongs to; `NONE`: the track has no target.

    Args:
        truth: points.
        tracks: points; rows of one label are one track, in all views.
        tau: (n,) for each true row how near a track on it must be.
        t_ns: (m,) time of each row of the tracks.
        how: `label`: the target of the same label; `start`: the first target that the track is on,
            in any view, of several at that time the nearest in terms of tau; `best`: by the
            one-to-one assignment over all views in which most estimates are on their own target.
    """
    if how == "label":
        return tracks.label
    near = _near(truth, tracks, tau)
    own = _first(truth, tracks, near, t_ns) if how == "start" else _best(truth, tracks, near)
    keys, number = np.unique(tracks.label, return_inverse=True)
    return np.array([own.get(int(k), NONE) for k in keys], dtype=np.int64)[number]


def _near(truth: Objects, tracks: Objects, tau: Floats) -> NearPairs:
    """Pairs of rows of one frame at most `tau` apart."""
    frames = of_points(truth, tracks, 1.0)
    parts = [(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0))]
    reach = tau[frames.truth_row]
    for t in frames.meeting():
        left, right = frames.rows(t)
        share = frames.compare(t)[0] / reach[left, None]
        i, j = np.nonzero(share <= 1.0)
        parts.append((frames.truth_row[left][i], frames.track_row[right][j], share[i, j]))
    return NearPairs(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _first(truth: Objects, tracks: Objects, near: NearPairs, t_ns: Ints) -> dict[int, int]:
    """For each track the first target that it is on; of several at one time the nearest in terms of tau."""
    out: dict[int, int] = {}
    label = truth.label[near.truth]
    for row in np.lexsort((label, near.share, t_ns[near.track])).tolist():
        out.setdefault(int(tracks.label[near.track[row]]), int(label[row]))
    return out


def _best(truth: Objects, tracks: Objects, near: NearPairs) -> dict[int, int]:
    """One-to-one assignment of tracks to targets with the most pairs (Hungarian algorithm); only pairs that met."""
    targets, i = np.unique(truth.label, return_inverse=True)
    keys, j = np.unique(tracks.label, return_inverse=True)
    met = np.zeros((len(keys), len(targets)), dtype=np.int64)
    np.add.at(met, (j[near.track], i[near.truth]), 1)
    rows, columns = linear_sum_assignment(met, maximize=True)
    return {int(keys[r]): int(targets[c]) for r, c in zip(rows, columns, strict=True) if met[r, c]}


class Places(NamedTuple):
    """Truth and tracks as points, with the limits of distance and the frames that failures are told by."""

    truth: Objects
    tracks: Objects
    tau: Floats  # (n,) how near a tracker on a true row must be
    views: tuple[str, ...]
    t_ns: tuple[Ints, ...]  # for each view the times of its frames
    number: tuple[Ints, ...]  # for each view the numbers of its frames
    visible: Floats  # (n,) visible share of each true row
    unit: str  # of distances


def evaluate_views(compared: TruthAndTracks, config: ManyConfig) -> Evaluation:
    """Figures of boxes that have been laid against each other: all views pooled, then each view."""
    points = centres_and_limits(compared, config)
    found = find_failures(points, config)
    frames = of_boxes(compared.truth, compared.tracks)
    metrics: Metrics = failure_figures(found, found.frame >= 0, len(compared.truth.frame))
    metrics |= mot_figures(frames, config, sum(compared.frames)) | compared.counts
    metrics |= {"targets": len(frames.truth_key), "tracks": len(frames.track_key)}
    if config.gospa_px is not None:
        metrics |= _centre_gospa(points.truth, points.tracks, config, config.gospa_px, sum(compared.frames))
    if len(compared.views) > 1:
        metrics |= across_views(compared.truth, compared.tracks, config.overlap)
        for v, name in enumerate(compared.views):
            metrics |= _of_view(compared, found, config, v, f"_sensor_{name}")
    notes = [*_left_out(compared), *without_common_numbers(points, config)]
    flat = {name: float(value) for name, value in metrics.items()}
    return Evaluation(flat, failures=failure_rows(found, points), notes=tuple(notes))


def centres_and_limits(compared: TruthAndTracks, config: ManyConfig) -> Places:
    """Middles of the boxes; a target's radius is sqrt(half width * half height)."""
    radius = 0.5 * np.sqrt(compared.truth.place[:, 2] * compared.truth.place[:, 3])
    tau = config.tau * radius if config.tau_px is None else np.full(len(radius), config.tau_px)
    return Places(
        truth=centres(compared.truth),
        tracks=centres(compared.tracks),
        tau=tau,
        views=compared.views,
        t_ns=compared.t_ns,
        number=compared.number,
        visible=compared.visible,
        unit="px",
    )


def find_failures(places: Places, config: ManyConfig) -> failure_rates.Failures:
    """Failures of trackers, whose own targets are told by `config.own`."""
    own = own_targets(places.truth, places.tracks, places.tau, _times(places, places.tracks), config.own)
    return failure_rates.failures(places.truth, places.tracks, places.tau, own)


def failure_rows(found: failure_rates.Failures, places: Places) -> Failures:
    """The table of failures, by time, camera and target."""
    view = found.view.astype(np.int64)
    at = Objects(found.frame, found.target, np.zeros((len(view), 2)), view)
    names: Strings = np.array([*places.views, ""], dtype=np.str_)
    columns = {
        "t_ns": _times(places, at),
        "sensor": names[view],
        "frame": _numbers(places, at),
        "target_id": found.target.astype(np.int32),
        "kind": np.where(found.label, "label", "position"),
        "other_id": found.other.astype(np.int32),
        "cause": np.array(found.causes(places.unit), dtype=np.str_),
        "visible": _visible(at, places),
    }
    order = np.lexsort([columns[name] for name in ("kind", *reversed(Failures.KEY))])
    return Failures.of(**{name: column[order] for name, column in columns.items()})


def _views_of(side: Objects) -> Ints:
    return np.zeros(len(side.frame), dtype=np.int64) if side.view is None else side.view


def _times(places: Places, side: Objects) -> Ints:
    """(n,) time of each row."""
    starts = np.cumsum([0, *(len(t) for t in places.t_ns)])
    return np.concatenate([*places.t_ns, np.zeros(0, np.int64)])[starts[_views_of(side)] + side.frame]


def _numbers(places: Places, side: Objects) -> Ints:
    """(n,) number of each row's frame in the camera's stream."""
    starts = np.cumsum([0, *(len(t) for t in places.t_ns)])
    return np.concatenate([*places.number, np.zeros(0, np.int64)])[starts[_views_of(side)] + side.frame]


def _visible(at: Objects, places: Places) -> Floats:
    """(n,) visible share of the target of each row; NaN where it is not known or not in the frame."""
    known = zip(_views_of(places.truth).tolist(), places.truth.frame.tolist(), places.truth.label.tolist(), strict=True)
    share = dict(zip(known, places.visible.tolist(), strict=True))
    rows = zip(_views_of(at).tolist(), at.frame.tolist(), at.label.tolist(), strict=True)
    return np.array([share.get(row, np.nan) for row in rows], dtype=np.float64)


def _centre_gospa(
    truth: Objects, tracks: Objects, config: ManyConfig, cutoff: float, cells: int, whose: str = ""
) -> Metrics:
    return gospa_figures(of_points(truth, tracks, cutoff), config, cutoff, cells, whose, "px")


def _of_view(
    compared: TruthAndTracks, found: failure_rates.Failures, config: ManyConfig, v: int, whose: str
) -> Metrics:
    truth, tracks = of_view(compared.truth, v), of_view(compared.tracks, v)
    frames = of_boxes(truth, tracks)
    out = failure_figures(found, found.view == v, len(truth.frame), whose)
    out |= mot_figures(frames, config, compared.frames[v], whose)
    out |= {f"targets{whose}": len(frames.truth_key), f"tracks{whose}": len(frames.track_key)}
    out |= {f"frames{whose}": compared.frames[v]}
    if config.gospa_px is not None:
        out |= _centre_gospa(centres(truth), centres(tracks), config, config.gospa_px, compared.frames[v], whose)
    return out


def _left_out(compared: TruthAndTracks) -> list[str]:
    if not compared.left_out:
        return []
    return [f"left out: {', '.join(compared.left_out)}, which the truth knows and no track is in"]


def without_common_numbers(places: Places, config: ManyConfig) -> list[str]:
    """A line if the numbers of tracks and targets have nothing to do with each other."""
    ours, theirs = np.unique(places.tracks.label), np.unique(places.truth.label)
    if config.own != "label" or not len(ours) or np.isin(ours, theirs).any():
        return []
    return [
        f"no track has the number of a target ({_some(ours)}; {_some(theirs)}), so that every tracker is on another "
        "target than its own; own start gives each track the first target that it is on"
    ]


def _some(numbers: Ints) -> str:
    shown = ", ".join(str(n) for n in numbers[:6].tolist())
    return f"{shown}, ..." if len(numbers) > 6 else shown
