"""From sightings to a gallery, and from sightings with a gallery to decisions ([Lee] Sec. 5.2.1).

Also the identity of each track from all its boxes, and renaming of tracks.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import NamedTuple, TypeVar

import numpy as np

from occlog.array_types import Bools, Floats, Ints, Ints32
from occlog.core.image import bins_of, corrected
from occlog.errors import InputError
from occlog.records.declared.people import MAX_BINS, OTHER, SAME, SUSPENDED, AppearanceMatches, Gallery
from occlog.records.tables import Tracks

from .config import LearnConfig, MatchConfig, SightingConfig
from .sightings import NO_ID, Sighting, angle_bins

ANGLE, HEADING, COVERED, PIXELS = "angle", "heading", "covered", "pixels"
"""`reason` of a decision that is suspended."""


def learn(sightings: Iterable[Sighting], config: LearnConfig) -> Gallery:
    """Return the gallery: mean colour histogram of each target and viewing angle; every pixel has the same weight.

    Boxes without a track, with an unknown viewing angle, covered, or with too few pixels are skipped. The table is
    empty if no viewing angle of any person has enough boxes.
    """
    counts: dict[tuple[int, int], Floats] = {}
    samples: dict[tuple[int, int], int] = {}
    last_ns = 0
    for each in sightings:
        angle = angle_bins(each.angle, config.angles)
        good = (each.track != NO_ID) & (angle > 0) & (obstacles(each, config) == "")
        for k in np.flatnonzero(good).tolist():
            key = int(each.track[k]), int(angle[k])
            counts[key] = counts.get(key, np.zeros(bins_of(config.colour_levels))) + each.density[k] * each.pixels[k]
            samples[key] = samples.get(key, 0) + 1
            last_ns = each.boxes.t_ns
    keys = sorted(key for key, n in samples.items() if n >= config.min_samples)
    if not keys:
        return Gallery.empty()
    whole = np.stack([counts[key] for key in keys])
    densities = np.zeros((len(keys), MAX_BINS))
    densities[:, : whole.shape[1]] = whole / whole.sum(axis=1, keepdims=True)
    return Gallery(
        t_ns=np.full(len(keys), last_ns),
        target_id=np.array([target for target, _ in keys], dtype=np.int32),
        angle=np.array([n for _, n in keys], dtype=np.int32),
        angles=np.full(len(keys), config.angles, dtype=np.int32),
        bins=np.full(len(keys), bins_of(config.colour_levels), dtype=np.int32),
        samples=np.array([samples[key] for key in keys], dtype=np.int32),
        pixels=np.rint(whole.sum(axis=1)).astype(np.int64),
        density=densities,
    )


def obstacles(sighting: Sighting, config: SightingConfig) -> np.ndarray[tuple[int], np.dtype[np.str_]]:
    """Reasons why n boxes have no usable appearance.

    Args:
        sighting: n boxes with their covered shares and numbers of pixels.
        config: limits of both.

    Returns:
        (n,) `covered` if too much of the box is covered, else `pixels` if it has too few; empty text if it is usable.
    """
    few = sighting.pixels < config.min_pixels
    return np.where(sighting.covered > config.max_occlusion, COVERED, np.where(few, PIXELS, ""))


class GalleryArrays(NamedTuple):
    """Appearance gallery as arrays, for R targets, N viewing angles and m colour bins.

    Attributes:
        target: (R,) identities, ascending.
        density: (R, N, m) normalised histograms.
        pixels: (R, N) numbers of pixels in them.
        there: (R, N) mask of learned viewing angles.
        levels: number L of colour levels, with m = L (L + 1).
    """

    target: Ints32
    density: Floats
    pixels: Ints
    there: Bools
    levels: int


def sides_of(gallery: Gallery) -> GalleryArrays:
    """Convert a gallery to arrays; InputError if it is empty, or its number of bins is not L (L + 1) for any L."""
    if not len(gallery):
        raise InputError("gallery: has no rows; make one with occlog appearance learn", id="empty-input")
    bins, angles = int(gallery.bins[0]), int(gallery.angles[0])
    levels = round((np.sqrt(4.0 * bins + 1.0) - 1.0) / 2.0)
    if bins_of(levels) != bins:
        raise InputError(
            f"gallery: has densities of {bins} bins, which is L (L + 1) for no number L of levels; make it again with "
            "occlog appearance learn"
        )
    target, row = np.unique(gallery.target_id, return_inverse=True)
    column = gallery.angle - 1
    density, pixels = np.zeros((len(target), angles, bins)), np.zeros((len(target), angles), dtype=np.int64)
    density[row, column], pixels[row, column] = gallery.density[:, :bins], gallery.pixels
    return GalleryArrays(target, density, pixels, pixels > 0, levels)


def match(sightings: Iterable[Sighting], sides: GalleryArrays, config: MatchConfig) -> Iterator[AppearanceMatches]:
    """Compare each box with each target at the same viewing angle; generate one table per frame.

    A box is identified as the most similar target if the similarity is at least `config.min_similarity`; of several
    boxes most similar to one target only the most similar one is. Comparisons are suspended for a target without
    this viewing angle in the gallery `sides`, and for all targets if the viewing angle is unknown, or too much of
    the box is covered, or it has too few pixels.
    """
    n_targets, n_angles = sides.there.shape
    for each in sightings:
        n = len(each.boxes.box)
        angle = angle_bins(each.angle, n_angles)
        column = np.maximum(angle, 1) - 1
        # Reasons to suspend, the first of them
        own = obstacles(each, config)
        own = np.where((own == "") & (angle == 0), HEADING, own)
        reason = np.where(own[:, None] != "", own[:, None], np.where(sides.there[:, column].T, "", ANGLE))
        decided = reason == ""
        # Compare ([Lee] 5.5), the bias corrected
        rho, rho_corrected = np.full((2, n, n_targets), np.nan)
        for k in np.unique(column[decided.any(axis=1)]).tolist():
            rows, columns = np.flatnonzero((column == k) & decided.any(axis=1)), np.flatnonzero(sides.there[:, k])
            index = np.ix_(rows, columns)
            rho[index], rho_corrected[index] = corrected(
                each.density[rows], sides.density[columns, k], each.pixels[rows], sides.pixels[columns, k]
            )
        same = most_similar(rho_corrected, config.min_similarity)
        row, target = np.divmod(np.arange(n * n_targets), n_targets)
        yield AppearanceMatches(
            t_ns=np.full(n * n_targets, each.boxes.t_ns),
            sensor=np.full(n * n_targets, each.boxes.sensor),
            frame=np.full(n * n_targets, each.boxes.frame),
            box=each.boxes.box[row],
            track_id=each.track[row],
            target_id=sides.target[target],
            angle=angle[row],
            viewing_angle=each.angle[row],
            pixels=each.pixels[row],
            rho=rho.reshape(-1),
            rho_corrected=rho_corrected.reshape(-1),
            decision=np.where(decided, np.where(same, SAME, OTHER), SUSPENDED).reshape(-1),
            reason=reason.reshape(-1),
        )


def most_similar(similarities: Floats, least: float) -> Bools:
    """(n, R) mask of pairs of n boxes and R targets: each box with its most similar target, one box per target.

    Args:
        similarities: (n, R) similarities; NaN: not compared.
        least: minimum similarity of a pair.
    """
    filled = np.where(np.isnan(similarities), -np.inf, similarities)
    out = np.zeros(similarities.shape, dtype=np.bool_)
    if not similarities.size:
        return out
    box = np.arange(len(similarities))
    best = filled.argmax(axis=1)
    value = filled[box, best]
    for target in np.unique(best[value >= least]).tolist():
        rows = np.flatnonzero((best == target) & (value >= least))
        out[rows[value[rows].argmax()], target] = True
    return out


T = TypeVar("T", bound=Tracks)


class IdentityEvidence(NamedTuple):
    """Similarity of the boxes of K tracks to R targets of a gallery, summed over boxes.

    Attributes:
        track: (K,) identities of the tracks, ascending.
        target: (R,) identities of the targets, ascending.
        similarities: (K, R) sums of Bhattacharyya coefficients, corrected for their bias.
        boxes: (K, R) numbers of boxes that were compared.
    """

    track: Ints32
    target: Ints32
    similarities: Floats
    boxes: Ints


class EvidenceTally:
    """Sums the similarities of tracks and targets over a stream of match tables."""

    def __init__(self) -> None:
        """Start without compared pairs."""
        self._sums: dict[tuple[int, int], tuple[float, int]] = {}

    def add(self, part: AppearanceMatches) -> None:
        """Add the similarities of all compared boxes that have a track."""
        rows = np.flatnonzero((part.decision != SUSPENDED) & (part.track_id != NO_ID))
        columns = (part.track_id[rows], part.target_id[rows], part.rho_corrected[rows])
        for track, target, value in zip(*(c.tolist() for c in columns), strict=True):
            total, n = self._sums.get((track, target), (0.0, 0))
            self._sums[track, target] = total + value, n + 1

    def evidence(self) -> IdentityEvidence:
        """Sums of the similarities of each track with each target so far, and the numbers of boxes."""
        track, target = (np.unique(np.array([k[i] for k in self._sums], dtype=np.int32)) for i in (0, 1))
        similarities, boxes = np.zeros((len(track), len(target))), np.zeros((len(track), len(target)), dtype=np.int64)
        for (name, other), (total, n) in self._sums.items():
            index = np.searchsorted(track, name), np.searchsorted(target, other)
            similarities[index], boxes[index] = total, n
        return IdentityEvidence(track, target, similarities, boxes)


def identities(
    evidence: IdentityEvidence, together: Bools, similarity_limit: float, least_boxes: int
) -> dict[int, int]:
    """Target of each track with sufficient evidence, by track; a target may have several tracks at different times.

    Pairs of track and target are assigned greedily by mean similarity. A track has one target, and tracks that coexist
    have different targets.

    Args:
        evidence: similarity sums of K tracks and R targets.
        together: (K, K) mask of pairs of tracks that exist at the same time.
        similarity_limit: minimum mean similarity of a pair.
        least_boxes: minimum number of boxes of a pair.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = evidence.similarities / evidence.boxes
    mean = np.where((evidence.boxes >= least_boxes) & (mean >= similarity_limit), mean, -np.inf)
    out: dict[int, int] = {}
    while mean.size and np.isfinite(mean.max()):
        track, target = np.unravel_index(int(mean.argmax()), mean.shape)
        out[int(evidence.track[track])] = int(evidence.target[target])
        mean[track] = -np.inf
        mean[together[track], target] = -np.inf
    return out


def tracks_together(tracks: Tracks, which: Ints32) -> Bools:
    """(K, K) mask of tracks with overlapping time spans; True on the diagonal.

    `which` (K,) are the identities of the tracks; one without rows overlaps with no track, not even itself.
    """
    first, last = np.full(len(which), np.iinfo(np.int64).max), np.full(len(which), np.iinfo(np.int64).min)
    for k, name in enumerate(which.tolist()):
        own = tracks.t_ns[tracks.target_id == name]
        if len(own):
            first[k], last[k] = own[0], own[-1]
    return np.asarray((first[:, None] <= last[None, :]) & (first[None, :] <= last[:, None]))


def renamed(tracks: T, named: dict[int, int], gallery: Iterable[int]) -> tuple[T, dict[int, int]]:
    """Rename tracks to the identities of a gallery; also return the new name of every track by the old one.

    Other tracks get numbers above all identities of the gallery, in their order.

    Args:
        tracks: tracks to rename.
        named: identity in the gallery by track.
        gallery: all identities of the gallery.
    """
    names = np.unique(tracks.target_id)
    free = 1 + max(gallery, default=-1)
    rest = [name for name in names.tolist() if name not in named]
    new = named | {name: free + k for k, name in enumerate(rest)}
    target = np.array([new[name] for name in names.tolist()], dtype=np.int32)[np.searchsorted(names, tracks.target_id)]
    return replace(tracks, target_id=target).sorted(), {name: new[name] for name in names.tolist()}
