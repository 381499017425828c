"""Everybody under the identities of a gallery: tables are held back until it is known who is who."""

from __future__ import annotations

import pickle
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from occlog.array_types import Ints, Ints32
from occlog.errors import InputError, option
from occlog.io.open import Opened, losses_of, open_input
from occlog.measure.appearance.config import MatchConfig
from occlog.measure.appearance.identities import EvidenceTally
from occlog.measure.appearance.sightings import FrameBoxes, SightingTally, boxes_of_frames, paths_of_rows, sightings
from occlog.measure.appearance.stage import match, sides_of
from occlog.measure.label.by_appearance import DecisionTally
from occlog.measure.label.config import NamingConfig
from occlog.records.frames import Frame
from occlog.records.losses import Loss
from occlog.records.tables import Boxes, Events, Gallery, Tracks, Views
from occlog.track.people.inputs import PeopleInput
from occlog.track.people.rows import LIKELY, MomentTables, SeenMoment

from .pieces import DOUBT, Cut, Names, Pieces, begun, named_events, named_tracks, names_of, pieces_of

NOBODY = -1


class _Rows(NamedTuple):
    """What is kept of the tracks in memory: some 50 bytes a row, and some 30 for each box that speaks for one."""

    t_ns: Ints
    target_id: Ints32
    state: np.ndarray[tuple[int, int], np.dtype[np.float32]]  # x, y, vx, vy
    frame: Ints  # of a box that is more probably of a person than not
    camera: Ints32
    box: Ints32
    whose: Ints32


class ByGallery:
    """Names for the tracks of everybody, by a gallery.

    Attributes:
        parameters: for the provenance.
    """

    def __init__(self, gallery: Path, inputs: PeopleInput) -> None:
        """Open the gallery and the images; InputError where there are none, and the boxes bring no colours."""
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
        """What was lost when the gallery and the images were made, and of the images here."""
        own = self._images if self._images is not self._inputs.opened else None
        return (*losses_of([self._opened, own]), *self._seen.losses())

    def notes(self) -> Iterator[str]:
        """What a user must know beside the figures."""
        if self._figures and not self._figures["tracks_named"]:
            seen = self._decisions
            why = ", ".join(f"{name} {count}" for name, count in sorted(seen.reasons.items())) or "none"
            yield (
                f"warning: gallery: no track is anybody's of the gallery, by {seen.decided} comparisons of "
                f"{seen.boxes} boxes (suspended: {why}); `occlog label --gallery` says of each box why"
            )

    def figures(self) -> dict[str, object]:
        """For the summary, once everybody has a name."""
        return {"gallery": {**self._figures, **self._decisions.summary()}}

    def named(self, parts: Iterable[tuple[list[SeenMoment], MomentTables]]) -> Iterator[MomentTables]:
        """The tables of all parts under new names, when the last part has come; they wait in a temporary file."""
        kept: list[_Rows] = []
        cuts: list[Cut] = []
        with tempfile.TemporaryFile() as spool:
            count = 0
            place = {name: c for c, name in enumerate(self._inputs.names)}
            for seen, part in parts:
                pickle.dump(part, spool, pickle.HIGHEST_PROTOCOL)
                count += 1
                kept.append(_rows(part, place))
                cuts += [
                    Cut(event.id, min(look.look.t_ns for look in each.looks), event.other)
                    for each in seen
                    for event in each.moment.events
                    if event.kind == DOUBT
                ]
            if not count:
                return
            rows = _Rows._make(np.concatenate(columns) for columns in zip(*kept, strict=True))
            kept.clear()
            pieces = pieces_of(rows.target_id, rows.t_ns, cuts)
            names = self._names(rows, pieces)
            spool.seek(0)
            last_ns = np.iinfo(np.int64).min
            for _ in range(count):
                part = pickle.load(spool)
                first_ns, last_ns = last_ns + 1, int(part.tracks.t_ns[-1]) if len(part.tracks) else last_ns
                yield _renamed(part, pieces, names, first_ns, last_ns)

    def _names(self, rows: _Rows, pieces: Pieces) -> Names:
        """Look at the boxes, and say who is who."""
        tally = EvidenceTally()
        table = Boxes if self._inputs.opened.has(Boxes) else Views
        frames = boxes_of_frames(self._inputs.opened.rows(table))  # type: ignore[arg-type]
        images: Iterable[Frame] = ()
        if self._images is not None and self._images.recording is not None:
            images = self._images.recording.frames()
        found = sightings(
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
        names = names_of(pieces, tally.evidence(), people, self._config.least_likeness, self._naming.least_boxes)
        told = np.isfinite(names.probability)
        self._figures = {
            "tracks": len(pieces.tracks),
            "tracks_named": len(np.unique(pieces.track[told])),
            "pieces": len(pieces.track),
            "pieces_named": int(told.sum()),
            "people_named": len(np.unique(names.name[told])),
            **({"least_probability": float(names.probability[told].min())} if told.any() else {}),
        }
        return names


def _images(inputs: PeopleInput) -> Opened | None:
    """Where the images are; None: boxes bring colours."""
    if not inputs.opened.has(Boxes):
        return None
    scene = inputs.request.scene
    beside = None if scene is None or scene.suffix != ".mcap" else open_input(scene)
    for opened in (inputs.opened, beside):
        if opened is not None and opened.recording is not None and opened.recording.cameras:
            return opened
    raise InputError(
        f"{inputs.request.bearings}: a gallery says how people look, and there are no images, and the boxes bring no "
        f"colours; give the recording with the video for {option('scene')}, or views of `occlog detect`"
    )


def _rows(part: MomentTables, place: dict[str, int]) -> _Rows:
    tracks, support = part.tracks, part.support.take(part.support.probability > LIKELY)
    return _Rows(
        t_ns=tracks.t_ns,
        target_id=tracks.target_id,
        state=np.column_stack([tracks.x, tracks.y, tracks.vx, tracks.vy]).astype(np.float32),
        frame=support.frame,
        camera=np.array([place[name] for name in support.sensor.tolist()], dtype=np.int32),
        box=support.box,
        whose=support.target_id,
    )


def _tracks(rows: _Rows) -> Tracks:
    """The rows as paths are made of; how sure they are is not asked."""
    x, y, vx, vy = rows.state.astype(np.float64).T
    one = np.ones(len(x))
    return Tracks.of(
        t_ns=rows.t_ns, target_id=rows.target_id, x=x, y=y, vx=vx, vy=vy, cov_xx=one, cov_xy=0.0 * one, cov_yy=one
    )


def _owned(frames: Iterable[FrameBoxes], rows: _Rows, names: tuple[str, ...]) -> Iterator[FrameBoxes]:
    """Boxes with the track that each speaks for, of the cameras in use."""
    order = np.lexsort((rows.frame, rows.camera))
    camera, frame = rows.camera[order], rows.frame[order]
    starts = np.searchsorted(camera, np.arange(len(names) + 1))
    place = {name: c for c, name in enumerate(names)}
    for each in frames:
        if each.sensor not in place:
            continue
        c = place[each.sensor]
        here = frame[starts[c] : starts[c + 1]]
        at = starts[c] + np.arange(*np.searchsorted(here, [each.frame, each.frame + 1]))
        mine = dict(zip(rows.box[order[at]].tolist(), rows.whose[order[at]].tolist(), strict=True))
        whose = [mine.get(box, NOBODY) for box in each.box.tolist()]
        yield each._replace(identity=np.array(whose, dtype=np.int32))


def _renamed(part: MomentTables, pieces: Pieces, names: Names, first_ns: int, last_ns: int) -> MomentTables:
    """A part under new names, with the pieces that begin at its times."""
    events = named_events(part.events, pieces, names)
    told = Events.of_rows(begun(pieces, names, first_ns, last_ns))
    support, views = part.support, part.views
    own = names.name[pieces.of(support.target_id, support.t_ns)]
    if views is not None:
        views = replace(views, target_id=names.name[pieces.of(views.target_id, views.t_ns)]).sorted()
    return MomentTables(
        tracks=named_tracks(part.tracks, events, pieces, names),
        support=replace(support, target_id=own).sorted(),
        events=Events.merge([events, told]),
        views=views,
    )
