"""Messages for a viewer, sorted by time: table rows and frames.

At one time truth is first, then filter diagnostics, estimates, and images with the drawings over them. Time steps of
long recordings are thinned, since viewers keep the whole file in memory.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS
from occlog.records.columns import ColumnTable
from occlog.records.frames import Frame
from occlog.records.scene import Camera
from occlog.records.tables import (
    Bearings,
    Bound,
    Boxes,
    Diagnostics,
    Doa,
    Errors,
    Events,
    Hulls,
    Occluders,
    Particles,
    PeopleTracks,
    Truth,
    TruthBoxes,
    Views,
    ViewTracks,
)

from .drawings.people import (
    STALE_NS,
    DiagnosticsDrawing,
    Palette,
    PeopleDrawing,
    boxes_in_image,
    people_of,
    tracked_in_image,
    true_in_space,
)
from .drawings.shapes import GREY, Dots, DrawingGroup, Polyline, at_height, faded
from .drawings.world import SightDrawing, moving_occluders
from .inputs import ViewerInputs
from .series import Series

LAYERS: dict[type[ColumnTable], str] = {
    ViewTracks: "annotations",
    Views: "boxes",
    Boxes: "boxes",
    TruthBoxes: "true_boxes",
}
"""Overlays of an image can be shown separately: targets, boxes of a detector, true boxes."""
PARTICLES = "/particles"
"""The topic of dots alone, which all viewers draw of clouds of points."""
SHADOWS_NS = NS // 5
"""Shadows of people are drawn at most this often: they take the most work."""


class SceneDrawing(NamedTuple):
    """Shapes in the world [m] that a viewer shows until the topic's next ones.

    Attributes:
        topic: topic in the viewer's file.
        t_ns: time from which they are shown [ns].
        things: groups of shapes.
    """

    topic: str
    t_ns: int
    things: list[DrawingGroup]


class ImageOverlay(NamedTuple):
    """A frame of a camera, and the shapes drawn over it.

    Attributes:
        frame: the frame.
        layers: groups of shapes by layer (a name in `LAYERS`).
    """

    frame: Frame
    layers: dict[str, list[DrawingGroup]]


class Numbers(NamedTuple):
    """One sample of a series that a viewer plots over time.

    Attributes:
        topic: topic in the viewer's file.
        t_ns: time [ns].
        series: declaration of the series, with its fields.
        values: value of each field; NaN: unknown.
    """

    topic: str
    t_ns: int
    series: Series
    values: list[float]


class LogLine(NamedTuple):
    """Message for the viewer's log.

    Attributes:
        t_ns: time [ns].
        warns: whether it is a warning.
        source: subject of the message.
        words: text of the message.
    """

    t_ns: int
    warns: bool
    source: str
    words: str


StreamItem = SceneDrawing | ImageOverlay | Numbers | LogLine


class ViewerStream:
    """Generates everything that a viewer shows, sorted by time, in one pass and bounded memory."""

    def __init__(self, inputs: ViewerInputs) -> None:
        """Create the stream; identities are read first, to assign colours."""
        self._inputs, self._metres = inputs, inputs.metres
        self.palette = Palette(inputs.targets())
        self.crowd = PeopleDrawing(self.palette)
        scene = inputs.scene
        self._sight = None if scene is None else SightDrawing(scene, self._metres, self.palette, self.crowd)
        self._cameras: dict[str, Camera] = {} if scene is None else {c.name: c for c in scene.cameras}
        self._diagnostics_drawing = DiagnosticsDrawing()
        self._over: dict[str, dict[str, tuple[int, list[DrawingGroup]]]] = {}
        self._stands: dict[str, tuple[int, int]] = {}  # by topic when it was drawn, and until when that is valid
        self._selects = False  # whether cameras were ever selected
        self._next_shadows = -(1 << 62)

    def items(self) -> Iterator[StreamItem]:
        """Generate the items of all inputs, sorted by time."""
        sources: list[Iterator[tuple[int, int, Callable[[], Iterator[StreamItem]]]]] = []

        def add(order: int, rows: Iterator[object], show: Callable[..., Iterator[StreamItem]]) -> None:
            sources.append(_timed(order, rows, show))

        pieces = self._inputs.pieces
        add(0, pieces(Truth), self._truth)
        add(1, pieces(Diagnostics), self._diagnostics)
        add(2, pieces(PeopleTracks), self._tracks)
        add(2, pieces(Particles), self._particles)
        add(3, pieces(Occluders), self._occluders)
        add(3, pieces(Hulls), self._hulls)
        add(4, pieces(Bearings), self._bearings)
        add(4, pieces(Doa), self._doa)
        add(5, pieces(Errors), self._errors)
        add(5, pieces(Bound), self._bound)
        add(6, pieces(Events), self._events)
        for kind in LAYERS:
            add(7, pieces(kind), partial(self._in_image, LAYERS[kind]))
        if self._inputs.recording is not None:
            add(8, self._inputs.recording.frames(), self._frame)
        for t_ns, _, show in heapq.merge(*sources, key=lambda entry: entry[:2]):
            yield from self._ended(t_ns)
            for item in show():
                if isinstance(item, SceneDrawing):
                    self._note(item)
                yield item

    def _note(self, item: SceneDrawing) -> None:
        """Record how long a drawing is valid: 2.5 times the interval since the previous one of its topic, or 1 s."""
        before = self._stands.get(item.topic)
        elapsed = 0 if before is None else item.t_ns - before[0]
        self._stands[item.topic] = (item.t_ns, item.t_ns + max(STALE_NS, 5 * elapsed // 2))
        if not item.things:
            del self._stands[item.topic]

    def _ended(self, t_ns: int) -> Iterator[StreamItem]:
        """Generate empty drawings that clear topics with drawings that expired before the time `t_ns` [ns].

        A viewer would show the last drawing forever.
        """
        for topic, (_, until) in list(self._stands.items()):
            if t_ns > until:
                del self._stands[topic]
                yield SceneDrawing(topic, until, [])

    def _truth(self, rows: Truth) -> Iterator[StreamItem]:
        yield SceneDrawing("/truth", int(rows.t_ns[0]), true_in_space(rows, self._metres))

    def _diagnostics(self, rows: Diagnostics) -> Iterator[StreamItem]:
        t_ns = int(rows.t_ns[0])
        yield from _numbers("/diagnostics", Series.of_table(Diagnostics), rows, rows.target_id.tolist())
        before = dict(self._diagnostics_drawing.quality_flags)
        self._diagnostics_drawing.add(rows)
        for target, words in self._diagnostics_drawing.quality_flags.items():
            if words and words != before.get(target):
                yield LogLine(t_ns, True, f"target {target}", words)
        chosen = sorted({name for text in rows.selected.tolist() for name in text.split(",") if name})
        if self._sight is not None and (chosen or self._selects):
            self._selects = True
            yield SceneDrawing("/selected", t_ns, self._sight.chosen(chosen))

    def _tracks(self, rows: PeopleTracks) -> Iterator[StreamItem]:
        t_ns = int(rows.t_ns[0])
        people = people_of(rows, self._metres, self._diagnostics_drawing)
        for person in people:
            before = self.crowd.find(person.target)
            if (
                person.quality_flags
                and not self._inputs.has(Diagnostics)
                and (before is None or before.quality_flags != person.quality_flags)
            ):
                yield LogLine(t_ns, True, f"target {person.target}", person.quality_flags)
        self.crowd.add(people)
        yield SceneDrawing("/targets", t_ns, self.crowd.in_space(t_ns))
        yield from _numbers("/tracks", Series.of_table(PeopleTracks), rows, rows.target_id.tolist())
        if self._sight is not None and self._cameras and t_ns >= self._next_shadows:
            self._next_shadows = t_ns + SHADOWS_NS
            yield SceneDrawing("/shadows", t_ns, self._sight.shadows(t_ns))

    def _particles(self, rows: Particles) -> Iterator[StreamItem]:
        positions = at_height(self._metres * np.column_stack([rows.x, rows.y]), 0.03)
        things = []
        for target in np.unique(rows.target_id).tolist():
            dots = Dots(positions[rows.target_id == target], faded(self.palette(target), 0.6))
            things.append(DrawingGroup(f"particles {target}", dots=[dots]))
        yield SceneDrawing(PARTICLES, int(rows.t_ns[0]), things)

    def _occluders(self, rows: Occluders) -> Iterator[StreamItem]:
        t_ns, rows = int(rows.t_ns[0]), rows.take(rows.occluder_id >= 0)
        covariances = np.stack([rows.cov_xx, rows.cov_xy, rows.cov_xy, rows.cov_yy], axis=1).reshape(-1, 2, 2)
        middles = np.column_stack([rows.x, rows.y])
        yield SceneDrawing("/occluders", t_ns, moving_occluders(middles, covariances, self._metres))

    def _hulls(self, rows: Hulls) -> Iterator[StreamItem]:
        things = []
        for number in np.unique(rows.occluder_id[rows.occluder_id >= 0]).tolist():
            own = rows.take(rows.occluder_id == number)
            ring = self._metres * np.column_stack([own.x, own.y])
            line = Polyline(at_height(np.vstack([ring, ring[:1]]), 0.02), GREY, 1.5, dashed=True)
            things.append(DrawingGroup(f"occluder {number}", lines=[line]))
        yield SceneDrawing("/occluders", int(rows.t_ns[0]), things)

    def _bearings(self, rows: Bearings) -> Iterator[StreamItem]:
        seen = np.where(rows.seen, rows.bearing, np.nan)
        yield from self._lines(str(rows.sensor[0]), int(rows.t_ns[0]), rows.target_id.tolist(), seen.tolist())

    def _doa(self, rows: Doa) -> Iterator[StreamItem]:
        unlabelled = [-1] * len(rows)
        yield from self._lines(str(rows.sensor[0]), int(rows.t_ns[0]), unlabelled, rows.azimuth.tolist())

    def _lines(self, sensor: str, t_ns: int, targets: list[int], azimuths: list[float]) -> Iterator[StreamItem]:
        things = None if self._sight is None else self._sight.lines(sensor, targets, azimuths)
        if things is not None:
            yield SceneDrawing(f"/sight_lines/{sensor}", t_ns, things)

    def _errors(self, rows: Errors) -> Iterator[StreamItem]:
        yield from _numbers("/errors", Series.of_table(Errors), rows, rows.target_id.tolist())

    def _bound(self, rows: Bound) -> Iterator[StreamItem]:
        yield from _numbers("/bound", Series.of_table(Bound), rows, rows.target_id.tolist())

    def _events(self, rows: Events) -> Iterator[StreamItem]:
        for kind, target, other, probability in zip(
            rows.kind.tolist(), rows.target_id.tolist(), rows.other_id.tolist(), rows.probability.tolist(), strict=True
        ):
            words = f"{kind} {'with ' + str(other) + ' ' if other >= 0 else ''}".strip()
            sure = "" if math.isnan(probability) else f", probability {probability:.3g}"
            yield LogLine(int(rows.t_ns[0]), kind == "possible_switch", f"target {target}", f"{words}{sure}")

    def _in_image(self, layer: str, rows: ViewTracks | Views | Boxes | TruthBoxes) -> Iterator[StreamItem]:
        things = tracked_in_image(rows, self.palette) if isinstance(rows, ViewTracks) else boxes_in_image(rows)
        self._over.setdefault(str(rows.sensor[0]), {})[layer] = (int(rows.t_ns[0]), things)
        yield from ()

    def _frame(self, frame: Frame) -> Iterator[StreamItem]:
        known = self._over.get(frame.sensor, {})
        layers = {name: things for name, (t_ns, things) in known.items() if t_ns == frame.t_ns}
        camera = self._cameras.get(frame.sensor)
        if not self._inputs.has(ViewTracks) and camera is not None and camera.has_height:
            layers[LAYERS[ViewTracks]] = self.crowd.in_image(camera, self._metres, frame.t_ns)
        yield ImageOverlay(frame, layers)


def _timed(
    order: int, rows: Iterator[object], show: Callable[..., Iterator[StreamItem]]
) -> Iterator[tuple[int, int, Callable[[], Iterator[StreamItem]]]]:
    """Generate for each part of a source its time [ns], the rank of the source, and a function for its items.

    Args:
        order: rank among sources with parts of the same time.
        rows: parts, in the order of time.
        show: generates the items of a part.
    """
    for piece in rows:
        times = piece.t_ns  # type: ignore[attr-defined]
        yield int(times if isinstance(times, int) else times[0]), order, partial(show, piece)


def _numbers(topic: str, series: Series, rows: object, targets: list[int]) -> Iterator[StreamItem]:
    """Generate the numbers in rows of one time, those of each target on the topic `topic/target`.

    Args:
        topic: first part of the topics.
        series: columns that are taken.
        rows: table with a row for each target.
        targets: identity of the target of each row.
    """
    columns = [np.asarray(getattr(rows, name), dtype=np.float64).tolist() for name in series.fields]
    t_ns = int(rows.t_ns[0])  # type: ignore[attr-defined]
    for target, values in zip(targets, zip(*columns, strict=True), strict=True):
        yield Numbers(f"{topic}/{target}", t_ns, series, list(values))


class Thinner:
    """Selects the first item of each topic in each time interval, for long recordings.

    Each message shows the whole state of its topic, so that any of them may be omitted. Intervals are the same for all
    topics, so that images and drawings correspond. All log lines are kept.
    """

    def __init__(self, every_ns: int) -> None:
        """Start with intervals of the length `every_ns` [ns], counted from the first item."""
        self._every_ns = every_ns
        self._begin: int | None = None
        self._kept: dict[str, int] = {}
        self._shown: set[str] = set()  # topics with a last message that shows something

    def keeps(self, item: StreamItem) -> bool:
        """Return whether an item is kept; items must be passed in the order of time."""
        if isinstance(item, LogLine):
            return True
        topic, t_ns = (
            (f"image of {item.frame.sensor}", item.frame.t_ns)
            if isinstance(item, ImageOverlay)
            else (item.topic, item.t_ns)
        )
        self._begin = t_ns if self._begin is None else self._begin
        if isinstance(item, SceneDrawing) and not item.things:
            # Nothing any more: the last drawing would stay forever
            shown = topic in self._shown
            self._shown.discard(topic)
            return shown
        segment = (t_ns - self._begin) // self._every_ns
        if self._kept.get(topic) == segment:
            return False
        self._kept[topic] = segment
        self._shown.add(topic)
        return True
