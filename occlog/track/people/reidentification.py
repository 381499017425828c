"""Re-identification of tracks with an appearance gallery: tracks are renamed to the gallery's identities.

A track belongs to one person, except where its identity may have been exchanged (`possible_switch`). It is split there,
and each fragment gets its own identity, so that appearance corrects identity switches. Output waits until all
identities are known.
"""

from __future__ import annotations

import pickle
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints, Ints32
from occlog.errors import InputError, option
from occlog.io.open import Opened, input_losses, open_input
from occlog.measure.appearance.config import MatchConfig
from occlog.measure.appearance.sightings import FrameBoxes, SightingTally, boxes_of_frames, observe_boxes, paths_of_rows
from occlog.measure.appearance.stage import EvidenceTally, IdentityEvidence, identities, match, sides_of
from occlog.measure.associate.config import NamingConfig
from occlog.measure.associate.run import DecisionTally
from occlog.records.declared.people import POSSIBLE_SWITCH, has_word
from occlog.records.frames import Frame
from occlog.records.losses import Loss
from occlog.records.tables import Boxes, Events, Gallery, PeopleTracks, Tracks, Views

from .close_encounters import MIN_SWITCH_PROBABILITY
from .inputs import PeopleInput
from .rows import MIN_MAP_PROBABILITY, SnapshotTables, SnapshotWithDetections

REIDENTIFICATION_EVENT, SWITCH_EVENT = "reidentified", "possible_switch"
"""Kinds of events that affect names."""
CONSTANT, BY_MARGIN = -5.9, 142.0
"""Numbers of the logistic function, fitted."""
MIN_NAME_PROBABILITY = 0.5
"""Less probable names are none."""


class TrackSplit(NamedTuple):
    """A split of a track where its identity may have been exchanged with another one's.

    `t_ns` is the time of the first frame after it, `other` the identity of the other track.
    """

    track: int
    t_ns: int  # of the first frame after it
    other: int  # target from which they may have taken over


class TrackFragments(NamedTuple):
    """P fragments of K tracks, sorted by track and time.

    Per fragment: `track` identity, times `first_ns` and `last_ns` of its rows, `partners`, the tracks split together
    with it at its beginning, and the ascending search key `code`. `tracks` (K,) are the identities, `cuts` (T,) the
    times of all splits, both ascending.
    """

    track: Ints32  # (P,)
    first_ns: Ints  # (P,) of its rows
    last_ns: Ints  # (P,)
    partners: tuple[tuple[int, ...], ...]  # (P,) tracks that were cut at the beginning of this one, too
    tracks: Ints32  # (K,) identities, ascending
    cuts: Ints  # (T,) times of all cuts, ascending
    code: Ints  # (P,) ascending

    def of(self, track: Ints32, t_ns: Ints) -> Ints:
        """Return the fragment index (n,) of each row by its track and time; -1 if the track is unknown."""
        index = np.minimum(np.searchsorted(self.tracks, track), max(len(self.tracks) - 1, 0))
        known = self.tracks[index] == track if len(self.tracks) else np.zeros(len(track), dtype=np.bool_)
        code = index * (len(self.cuts) + 1) + np.searchsorted(self.cuts, t_ns, side="right")
        return np.where(known, np.searchsorted(self.code, code, side="right") - 1, -1)


def split_tracks(track: Ints32, t_ns: Ints, cuts: Sequence[TrackSplit]) -> TrackFragments:
    """Split tracks into fragments.

    Args:
        track: (n,) identity of each row.
        t_ns: (n,) time of each row.
        cuts: splits in any order; several of a track at one time count as one, those of unknown tracks are ignored.
    """
    tracks, times = np.unique(track), np.unique(np.array([c.t_ns for c in cuts], dtype=np.int64))
    n = len(times) + 1
    partners: dict[int, list[int]] = {}
    for cut in cuts:
        index = int(np.searchsorted(tracks, cut.track))
        if index < len(tracks) and tracks[index] == cut.track:
            partners.setdefault(index * n + int(np.searchsorted(times, cut.t_ns)) + 1, []).append(cut.other)
    code = np.unique(np.array([*(np.arange(len(tracks)) * n).tolist(), *partners], dtype=np.int64))
    out = TrackFragments(tracks[code // n], code, code, (), tracks, times, code)
    first, last = np.full(len(code), np.iinfo(np.int64).max), np.full(len(code), np.iinfo(np.int64).min)
    owner = out.of(track, t_ns)
    np.minimum.at(first, owner, t_ns)
    np.maximum.at(last, owner, t_ns)
    return out._replace(first_ns=first, last_ns=last, partners=tuple(tuple(partners.get(c, ())) for c in code.tolist()))


class FragmentNames(NamedTuple):
    """Identities assigned to P fragments of tracks.

    `name` (P,) is the identity, `probability` (P,) that it is right, for fragments identified by appearance (NaN:
    others).
    """

    name: Ints32  # (P,)
    probability: Floats  # (P,) that the person of the gallery is it; NaN: not enough boxes


def reidentify_fragments(
    pieces: TrackFragments,
    evidence: IdentityEvidence,
    gallery: Sequence[int],
    similarity_limit: float,
    least_boxes: int,
) -> FragmentNames:
    """Assign an identity to every fragment.

    A fragment with enough boxes gets the most similar person of the gallery; fragments that coexist get different
    persons. Other fragments get the identity of their track before or after or, if this is in use at the time, that of
    the track with which they may have been exchanged. Remaining tracks get new numbers, above all of the gallery's.

    Args:
        pieces: fragments of all tracks.
        evidence: similarities, by fragment and person of the gallery.
        gallery: identities of the people of the gallery.
        similarity_limit: least mean similarity of a fragment's boxes to a person.
        least_boxes: least number of a fragment's boxes that were compared.
    """
    overlap = (pieces.first_ns[:, None] <= pieces.last_ns) & (pieces.first_ns <= pieces.last_ns[:, None])
    identified = identities(evidence, overlap[np.ix_(evidence.track, evidence.track)], similarity_limit, least_boxes)
    probability = np.full(len(pieces.track), np.nan)
    for row, piece in enumerate(evidence.track.tolist()):
        if piece in identified:
            probable = name_probability(evidence, row, identified[piece], similarity_limit, least_boxes)
            if probable < MIN_NAME_PROBABILITY:
                del identified[piece]
            else:
                probability[piece] = probable
    names = dict(identified)
    # A name is passed on if no other track has it in between
    for piece in sorted(set(range(len(pieces.track))) - set(identified), key=lambda p: (pieces.first_ns[p], p)):
        for name in _offers(pieces, piece, names):
            if not any(overlap[piece, p] for p, taken in names.items() if taken == name):
                names[piece] = name
                break
    free = 1 + max(gallery, default=-1)
    rest = {track: free + k for k, track in enumerate(np.unique(pieces.track[_unnamed(pieces, names)]).tolist())}
    every = [names.get(p, rest.get(int(t), free)) for p, t in enumerate(pieces.track.tolist())]
    return FragmentNames(np.array(every, dtype=np.int32), probability)


def _unnamed(pieces: TrackFragments, names: Mapping[int, int]) -> Bools:
    """Return a mask (P,) of the fragments without an identity in `names` (fragment index to identity)."""
    return np.array([p not in names for p in range(len(pieces.track))], dtype=np.bool_)


def _offers(pieces: TrackFragments, piece: int, names: Mapping[int, int]) -> list[int]:
    """Return candidate identities of a fragment, the best first.

    They are those of its track before and after it, and of the earlier fragments with which it may have been exchanged.

    Args:
        pieces: fragments of all tracks.
        piece: index of the fragment.
        names: identity of each fragment that has one already.
    """
    own = np.flatnonzero(pieces.track == pieces.track[piece])
    before, after = own[own < piece], own[own > piece]
    offers = [int(before[-1])] if len(before) else []
    offers += [int(after[0])] if len(after) else []
    for track in pieces.partners[piece]:
        earlier = np.flatnonzero((pieces.track == track) & (pieces.last_ns < pieces.first_ns[piece]))
        offers += earlier[-1:].tolist()
    return [names[p] for p in offers if p in names]


def name_probability(
    evidence: IdentityEvidence, row: int, target: int, similarity_limit: float, least_boxes: int
) -> float:
    """Return the probability that a fragment of a track is a given person of the gallery.

    A logistic function of the margin of its mean similarity to this person over the next person, or over the least
    similarity accepted for a box. Its numbers were fitted (docs/explanation/appearance.md).

    Args:
        evidence: similarities of fragments to the people of the gallery.
        row: index of the fragment in `evidence`.
        target: identity of the person.
        similarity_limit: least similarity accepted for a box.
        least_boxes: persons compared with fewer boxes are no rivals.
    """
    boxes = evidence.boxes[row]
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = evidence.similarities[row] / boxes
    own = int(np.searchsorted(evidence.target, target))
    rivals = mean[(boxes >= least_boxes) & (np.arange(len(mean)) != own)]
    margin = float(mean[own] - max(rivals.max(initial=-np.inf), similarity_limit))
    score = CONSTANT + BY_MARGIN * margin
    return float(1.0 / (1.0 + np.exp(-score)))


def named_events(events: Events, pieces: TrackFragments, names: FragmentNames) -> Events:
    """Return the events with the new identities of the fragments, sorted, without switches that appearance resolves.

    If the boxes of both people identify them before and after a possible switch, its probability is that of a wrong
    re-identification; events below `MIN_SWITCH_PROBABILITY` are dropped. `pieces` are the fragments, `names` their
    identities.
    """
    own, other = pieces.of(events.target_id, events.t_ns), pieces.of(events.other_id, events.t_ns)
    doubt = events.kind == SWITCH_EVENT
    left = events.probability.copy()
    for row in np.flatnonzero(doubt & (own >= 0) & (other >= 0)).tolist():
        after = [int(own[row]), int(other[row])]
        before = [p - 1 for p in after]
        if all(p >= 0 and pieces.track[p] == pieces.track[a] for p, a in zip(before, after, strict=True)):
            probability = names.probability[[*before, *after]]
            if np.isfinite(probability).all():
                left[row] = 1.0 - np.prod(probability)
    named = replace(
        events,
        target_id=np.where(own >= 0, names.name[own], events.target_id).astype(np.int32),
        other_id=np.where(other >= 0, names.name[other], events.other_id).astype(np.int32),
        probability=left,
    )
    return named.take(~doubt | ~(left < MIN_SWITCH_PROBABILITY)).sorted()


def reidentification_events(
    pieces: TrackFragments, names: FragmentNames, first_ns: int, last_ns: int
) -> list[tuple[int, str, int, int, float]]:
    """Return an event `reidentified`, as a row, for each fragment that was identified by appearance.

    A row is time [ns], kind, identity, -1, probability. Only fragments that begin from `first_ns` to `last_ns` count.
    `pieces` are the fragments, `names` their identities.
    """
    now = (pieces.first_ns >= first_ns) & (pieces.first_ns <= last_ns) & np.isfinite(names.probability)
    return [
        (int(pieces.first_ns[p]), REIDENTIFICATION_EVENT, int(names.name[p]), -1, float(names.probability[p]))
        for p in np.flatnonzero(now).tolist()
    ]


def named_tracks(tracks: PeopleTracks, doubts: Events, pieces: TrackFragments, names: FragmentNames) -> PeopleTracks:
    """Return the tracks with the new identities of their fragments, sorted by time and identity.

    The flag `possible_switch` stays only where `doubts` (events with the new identities) has such an event.
    """
    name = names.name[pieces.of(tracks.target_id, tracks.t_ns)]
    left = {(t, k) for t, k, kind in zip(*(c.tolist() for c in (doubts.t_ns, doubts.target_id, doubts.kind)),
                                         strict=True) if kind == SWITCH_EVENT}  # fmt: skip
    words = tracks.quality_flags.tolist()
    for row in np.flatnonzero(has_word(tracks.quality_flags, POSSIBLE_SWITCH)).tolist():
        if (int(tracks.t_ns[row]), int(name[row])) not in left:
            words[row] = ",".join(w for w in words[row].split(",") if w != POSSIBLE_SWITCH)
    return replace(tracks, target_id=name, quality_flags=np.array(words, dtype=np.str_)).sorted()


NO_ID = -1


class _TrackRows(NamedTuple):
    """Rows of tracks and associated boxes in memory, as columns.

    Per row of a track: time, identity and `state` (n, 4) x, y, vx, vy. Per box that is more probably of a person than
    not: frame number, camera index, box number and the identity of the person (`owner`).
    """

    t_ns: Ints
    target_id: Ints32
    state: np.ndarray[tuple[int, int], np.dtype[np.float32]]  # x, y, vx, vy
    frame: Ints  # of a box that is more probably of a person than not
    camera: Ints32
    box: Ints32
    owner: Ints32


class GalleryReidentification:
    """Re-identification of the tracks of all people with an appearance gallery.

    `named` takes all parts of the output and generates them with the gallery's identities; notes, figures and losses
    are complete then.

    Attributes:
        parameters: settings for the provenance.
    """

    def __init__(self, gallery: Path, inputs: PeopleInput) -> None:
        """Open the gallery, and the images if the boxes have no appearance.

        Raises:
            InputError: there are neither images nor appearances of boxes.
        """
        self._opened = open_input(gallery, Gallery)
        self._sides = sides_of(self._opened.read(Gallery))
        self._inputs = inputs
        self._config = MatchConfig.in_unit(inputs.scene.length_unit)
        self._naming = NamingConfig()
        self._images = _images(inputs)
        self._decisions, self._seen = DecisionTally(), SightingTally()
        self._figures: dict[str, object] = {}
        self.parameters = {"gallery": {**asdict(self._config), **asdict(self._naming)}}

    @property
    def losses(self) -> tuple[Loss, ...]:
        """Losses recorded in the gallery and the images, and losses of images in this run."""
        own = self._images if self._images is not self._inputs.opened else None
        return (*input_losses([self._opened, own]), *self._seen.losses())

    def notes(self) -> Iterator[str]:
        """Generate a warning text if no track was identified as a person of the gallery, with the reasons.

        Nothing is generated before `named` has finished.
        """
        if self._figures and not self._figures["tracks_reidentified"]:
            seen = self._decisions
            why = ", ".join(f"{name} {count}" for name, count in sorted(seen.reasons.items())) or "none"
            yield (
                f"warning: gallery: no track is of a person of the gallery, by {seen.decided} comparisons of "
                f"{seen.boxes} boxes (suspended: {why}); `occlog label --gallery` lists the reason for each box"
            )

    def figures(self) -> dict[str, object]:
        """Return the counts for the summary, under the key `gallery`; they are complete after `named`."""
        return {"gallery": {**self._figures, **self._decisions.summary()}}

    def named(self, parts: Iterable[tuple[list[SnapshotWithDetections], SnapshotTables]]) -> Iterator[SnapshotTables]:
        """Generate all parts of the output with the new identities.

        All parts are read first, and kept in a temporary file, since identities depend on the whole recording.

        Args:
            parts: time steps and tables of each part, in the order of time.
        """
        kept: list[_TrackRows] = []
        cuts: list[TrackSplit] = []
        with tempfile.TemporaryFile() as spool:
            count = 0
            index_of = {name: c for c, name in enumerate(self._inputs.names)}
            for seen, part in parts:
                pickle.dump(part, spool, pickle.HIGHEST_PROTOCOL)
                count += 1
                kept.append(_rows(part, index_of))
                cuts += [
                    TrackSplit(event.id, min(frame.detections.t_ns for frame in each.frames), event.other)
                    for each in seen
                    for event in each.snapshot.events
                    if event.kind == SWITCH_EVENT
                ]
            if not count:
                return
            rows = _TrackRows._make(np.concatenate(columns) for columns in zip(*kept, strict=True))
            kept.clear()
            pieces = split_tracks(rows.target_id, rows.t_ns, cuts)
            names = self._names(rows, pieces)
            spool.seek(0)
            last_ns = np.iinfo(np.int64).min
            for _ in range(count):
                part = pickle.load(spool)
                first_ns, last_ns = last_ns + 1, int(part.tracks.t_ns[-1]) if len(part.tracks) else last_ns
                yield _renamed(part, pieces, names, first_ns, last_ns)

    def _names(self, rows: _TrackRows, pieces: TrackFragments) -> FragmentNames:
        """Compare the boxes of the tracks `rows` with the gallery; return the identities of the fragments `pieces`.

        The counts for the summary are updated.
        """
        tally = EvidenceTally()
        table = Boxes if self._inputs.opened.has(Boxes) else Views
        frames = boxes_of_frames(self._inputs.opened.rows(table))  # type: ignore[arg-type]
        images: Iterable[Frame] = ()
        if self._images is not None and self._images.recording is not None:
            images = self._images.recording.frames()
        found = observe_boxes(
            _owned(frames, rows, self._inputs.names),
            images,
            paths_of_rows(_tracks(rows), self._config),
            self._inputs.scene,
            self._config,
            levels=self._sides.levels,
            own_identity=True,
            tally=self._seen,
        )
        by_piece = (
            each._replace(track=pieces.of(each.track, np.full(len(each.track), each.boxes.t_ns)).astype(np.int32))
            for each in found
        )
        for part in match(by_piece, self._sides, self._config):
            self._decisions.add(part)
            tally.add(part)
        people = self._sides.target.tolist()
        names = reidentify_fragments(
            pieces, tally.evidence(), people, self._config.min_similarity, self._naming.min_boxes
        )
        finite = np.isfinite(names.probability)
        self._figures = {
            "tracks": len(pieces.tracks),
            "tracks_reidentified": len(np.unique(pieces.track[finite])),
            "fragments": len(pieces.track),
            "fragments_reidentified": int(finite.sum()),
            "people_reidentified": len(np.unique(names.name[finite])),
            **({"least_probability": float(names.probability[finite].min())} if finite.any() else {}),
        }
        return names


def _images(inputs: PeopleInput) -> Opened | None:
    """Return the input that has images of the boxes; None if the boxes have appearances themselves (regions).

    Raises:
        InputError: the boxes have no appearance, and there are no images.
    """
    if not inputs.opened.has(Boxes):
        return None
    scene = inputs.request.scene
    recording = None if scene is None or scene.suffix != ".mcap" else open_input(scene)
    for opened in (inputs.opened, recording):
        if opened is not None and opened.recording is not None and opened.recording.cameras:
            return opened
    raise InputError(
        f"{inputs.request.bearings}: its boxes have neither images nor colours, by which {option('gallery')} knows "
        f"people; give the recording with the video as {option('scene')}, or a table of `occlog detect --views`",
        id="wrong-content",
    )


def _rows(part: SnapshotTables, index_of: dict[str, int]) -> _TrackRows:
    """Return the tracks of a part of the output, and their associated boxes, as columns.

    `index_of` is the camera index by name.
    """
    tracks, support = part.tracks, part.support.take(part.support.probability > MIN_MAP_PROBABILITY)
    return _TrackRows(
        t_ns=tracks.t_ns,
        target_id=tracks.target_id,
        state=np.column_stack([tracks.x, tracks.y, tracks.vx, tracks.vy]).astype(np.float32),
        frame=support.frame,
        camera=np.array([index_of[name] for name in support.sensor.tolist()], dtype=np.int32),
        box=support.box,
        owner=support.target_id,
    )


def _tracks(rows: _TrackRows) -> Tracks:
    """Return the rows as table `tracks`, with unit covariances (the comparison does not use them)."""
    x, y, vx, vy = rows.state.astype(np.float64).T
    one = np.ones(len(x))
    return Tracks.of(
        t_ns=rows.t_ns, target_id=rows.target_id, x=x, y=y, vx=vx, vy=vy, cov_xx=one, cov_xy=0.0 * one, cov_yy=one
    )


def _owned(frames: Iterable[FrameBoxes], rows: _TrackRows, names: tuple[str, ...]) -> Iterator[FrameBoxes]:
    """Generate the boxes of frames of the cameras `names`, with the identity of the track of each box (-1: none)."""
    order = np.lexsort((rows.frame, rows.camera))
    camera, frame = rows.camera[order], rows.frame[order]
    starts = np.searchsorted(camera, np.arange(len(names) + 1))
    index_of = {name: c for c, name in enumerate(names)}
    for each in frames:
        if each.sensor not in index_of:
            continue
        c = index_of[each.sensor]
        here = frame[starts[c] : starts[c + 1]]
        at = starts[c] + np.arange(*np.searchsorted(here, [each.frame, each.frame + 1]))
        mine = dict(zip(rows.box[order[at]].tolist(), rows.owner[order[at]].tolist(), strict=True))
        owner = [mine.get(box, NO_ID) for box in each.box.tolist()]
        yield each._replace(identity=np.array(owner, dtype=np.int32))


def _renamed(
    part: SnapshotTables, pieces: TrackFragments, names: FragmentNames, first_ns: int, last_ns: int
) -> SnapshotTables:
    """Return a part of the output with the new identities `names` of the fragments `pieces`.

    Events `reidentified` are added for fragments that begin from `first_ns` to `last_ns`.
    """
    events = named_events(part.events, pieces, names)
    named = Events.of_rows(reidentification_events(pieces, names, first_ns, last_ns))
    support, views = part.support, part.views
    own = names.name[pieces.of(support.target_id, support.t_ns)]
    if views is not None:
        views = replace(views, target_id=names.name[pieces.of(views.target_id, views.t_ns)]).sorted()
    return SnapshotTables(
        tracks=named_tracks(part.tracks, events, pieces, names),
        support=replace(support, target_id=own).sorted(),
        events=Events.merge([events, named]),
        views=views,
    )
