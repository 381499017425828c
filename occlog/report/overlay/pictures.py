"""Pictures of an overlay video: the frames of all cameras with tracks, and the plan.

Frames that cannot be decoded are empty, and listed as lost.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints
from occlog.errors import InputError, UsageError, option
from occlog.io.files.tables.parquet import read_provenance
from occlog.io.open import open_input
from occlog.io.recording.reader import McapRecording
from occlog.measure.detect.by_background.one_camera import segments
from occlog.measure.epipolar.matrices import known_geometry
from occlog.measure.epipolar.views import TrackedView
from occlog.records.columns import ColumnTable
from occlog.records.declared.views import Failures, ViewTracks
from occlog.records.frames import Frame, Image
from occlog.records.losses import Loss
from occlog.records.scene import Scene
from occlog.records.tables import Tracks, TruthBoxes
from occlog.report.request import OverlayRequest
from occlog.runner import Job
from occlog.settings import METRES

from .draw import BAR, FrameDrawing, LineDrawing, draw_shot, tile
from .plan import GroundTrackPositions, OverlayTables, PlanRenderer, Trails, extent_of, targets_of
from .stage import OverlayFrameRows, OverlayRig, frame_shot

NO_IMAGE = "no image: lost"
"""Text instead of an image."""


class LostFrames:
    """Decodes frames, and records which requested ones could not be decoded."""

    def __init__(self) -> None:
        """Create a record without lost frames."""
        self._why: dict[tuple[str, int], str] = {}
        self._missed: set[tuple[str, int]] = set()

    def image(self, frame: Frame) -> Image | None:
        """Return the decoded image; None if it cannot be decoded, which is recorded."""
        try:
            return frame.decode()
        except InputError as error:
            # The message begins with file, camera and frame; without them equal reasons are equal
            self._why[frame.sensor, frame.index] = str(error).rsplit(": ", 1)[-1]
            return None

    def is_lost(self, sensor: str, index: int) -> bool:
        """Return whether the frame with this index of a camera could not be decoded."""
        return (sensor, index) in self._why

    def miss(self, sensor: str, index: int) -> None:
        """Record that the frame `index` of the camera `sensor` is shown: a loss if it could not be decoded."""
        if self.is_lost(sensor, index):
            self._missed.add((sensor, index))

    @property
    def losses(self) -> tuple[Loss, ...]:
        """Losses: frames that were shown and could not be decoded, by camera, in ranges of indices."""
        sensors = sorted({sensor for sensor, _ in self._missed})
        lost = {name: sorted(index for sensor, index in self._missed if sensor == name) for name in sensors}
        return tuple(
            loss for name, own in lost.items() for loss in segments(name, [(n, self._why[name, n]) for n in own])
        )


T = TypeVar("T", bound=ColumnTable)
GOOD_HEIGHT = 360
"""Images lower than this are enlarged, by a whole number."""
LARGEST = (3840, 2160)
"""Width and height that no video exceeds unless a scale is given: images are made smaller [px]."""


class FrameRowReader(Generic[T]):
    """Reads the rows of single frames, by time and camera, from a table sorted by time; earlier rows are dropped.

    `read`, `used`: numbers of rows read so far, and of those returned.
    """

    def __init__(self, chunks: Iterable[T]) -> None:
        """Read these chunks, which are in the order of time."""
        self._chunks = iter(chunks)
        self._held: T | None = None
        self.read = self.used = 0

    def at(self, t_ns: int, sensor: str) -> T | None:
        """Return the rows of one frame, 0 or more, by time [ns] and camera; None if the table has no chunks.

        Times must not decrease from call to call.
        """
        while self._held is None or not len(self._held) or int(self._times(self._held)[-1]) <= t_ns:
            more = next(self._chunks, None)
            if more is None:
                break
            self.read += len(more)
            kept = self._held.take(self._times(self._held) >= t_ns) if self._held is not None else None
            self._held = more if kept is None else type(more).concat([kept, more])
        if self._held is None:
            return None
        own: Bools = (self._times(self._held) == t_ns) & (self._held.sensor == sensor)  # type: ignore[attr-defined]
        self.used += int(own.sum())
        return self._held.take(own)

    @staticmethod
    def _times(table: T) -> Ints:
        times: Ints = table.t_ns  # type: ignore[attr-defined]
        return times


class FrameOverlay:
    """Drawings of tracks in images and true boxes over single frames, which must be requested in the order of time."""

    def __init__(self, tracks: Path, truth: Path | None, trail_s: float) -> None:
        """Open tracks in images and, unless None, true boxes; `trail_s`: length of trails [s]."""
        self._tracks, self._truth = _rows(tracks, ViewTracks), _rows(truth, TruthBoxes)
        self._trails: dict[str, Trails] = {}
        self._trail_s = trail_s

    def shot(self, frame: Frame) -> FrameDrawing:
        """Return the drawings over a frame: ellipses of estimates with trails, and crosses at true positions."""
        rows = OverlayFrameRows(_at(self._tracks, frame), _at(self._truth, frame), None)
        # Without epipolar lines the size of a view is of no account
        rig = OverlayRig([TrackedView(frame.sensor, 1, 1)], [None], None, numbered=False)
        trails = self._trails.setdefault(frame.sensor, Trails(self._trail_s))
        ways = [] if rows.tracks is None else trails.ways(rows.tracks, frame.t_ns)
        return frame_shot(0, frame.index, [rows], rig)._replace(ways=ways)


class Pictures:
    """Iterable of the pictures of an overlay video: (frame index of the first camera, BGR picture of all views).

    A picture shows the latest frame of every camera; the next one begins when a camera that is in it has a new frame. A
    frame that cannot be decoded is black under its drawing.
    """

    def __init__(
        self, asked: OverlayRequest, recording: McapRecording, names: list[str], scene: Scene | None, job: Job
    ) -> None:
        self._recording, self.names, self.first = recording, names, names[0]
        self._tracks = _rows(asked.tracks, ViewTracks)
        boxed = asked.truth is not None and (asked.ground_tracks is None or open_input(asked.truth).has(TruthBoxes))
        self._truth = _rows(asked.truth, TruthBoxes) if boxed else None
        self._failures = _rows(asked.failures, Failures)
        self._lost = LostFrames()
        self._rig = _rig(asked, recording, names, scene, self._lost, job)
        self._followed = {
            path: kind for path, kind in ((asked.tracks, ViewTracks), (asked.ground_tracks, Tracks)) if path
        }
        self._ranks = targets_of(self._followed) if self._followed else {}
        self._trails = [Trails(asked.trail_s) for _ in names]
        self._numbers = [-1] * len(names)
        self._world = _world(asked, recording, scene, self._ranks, job)
        around = _around(asked, scene)
        shows_plan = len(around) > 0
        self._columns = _columns(len(names) + shows_plan)
        self.scale = asked.scale or self._good_scale(len(names) + shows_plan)
        self._plan = self._make_plan(scene, around) if shows_plan and scene is not None else None
        self._start = (recording.time_ns or (0, 0))[0]

    def _good_scale(self, cells: int) -> float:
        """Return the factor by which images are scaled: small ones are enlarged, large ones reduced.

        `cells`: number of images of a picture, with the plan; the picture fits into `LARGEST`.
        """
        height, width = (max(getattr(view, side) for view in self._rig.views) for side in ("height", "width"))
        rows = math.ceil(cells / self._columns)
        most = min(LARGEST[0] / (self._columns * width), (LARGEST[1] / rows - BAR) / height)
        return float(min(max(1, round(GOOD_HEIGHT / height)), most))

    def _make_plan(self, scene: Scene, around: Floats) -> PlanRenderer:
        height, width = (max(getattr(view, side) for view in self._rig.views) for side in ("height", "width"))
        size = (max(1, round(self.scale * width)), max(1, round(self.scale * height)))
        return PlanRenderer(scene, around, METRES.get(scene.length_unit, 1.0), size, self._ranks)

    def strange(self) -> bool:
        """Return whether the tracks in images have rows, but none of a frame so far: of another recording, perhaps."""
        return self._tracks is not None and self._tracks.read > 0 and not self._tracks.used

    def used(self) -> dict[str, int]:
        """Return the number of rows of each table that were drawn so far, by name."""
        tables = {"tracks": self._tracks, "world": self._world, "truth": self._truth, "failures": self._failures}
        return {name: rows.used for name, rows in tables.items() if rows is not None}

    def __iter__(self) -> Iterator[tuple[int, Image]]:
        images: list[Image] = [np.zeros((v.height, v.width, 3), dtype=np.uint8) for v in self._rig.views]
        numbers = self._numbers = [-1] * len(self.names)
        rows = [OverlayFrameRows(None, None, None)] * len(self.names)
        ways: list[list[LineDrawing]] = [[] for _ in self.names]
        fresh: set[int] = set()
        t_ns = 0
        for frame in self._recording.frames(self.names):
            view = self.names.index(frame.sensor)
            if view in fresh:
                yield numbers[0], self._drawn(images, numbers, rows, ways, t_ns)
                fresh.clear()
            image = self._lost.image(frame)
            images[view] = np.zeros_like(images[view]) if image is None else image
            numbers[view], rows[view] = frame.index, self._rows_of(frame)
            ways[view] = self._ways_of(view, frame, rows[view])
            t_ns = frame.t_ns
            fresh.add(view)
        if fresh:
            yield numbers[0], self._drawn(images, numbers, rows, ways, t_ns)

    @property
    def losses(self) -> tuple[Loss, ...]:
        """Losses: frames that could not be decoded and are missing in the pictures that were kept."""
        return self._lost.losses

    def keep(self) -> None:
        """Mark the last picture as kept: its missing frames are losses."""
        for name, number in zip(self.names, self._numbers, strict=True):
            self._lost.miss(name, number)

    def _rows_of(self, frame: Frame) -> OverlayFrameRows:
        """Return the rows of a frame in tracks, truth and failures (None for missing tables)."""
        return OverlayFrameRows(_at(self._tracks, frame), _at(self._truth, frame), _at(self._failures, frame))

    def _ways_of(self, view: int, frame: Frame, rows: OverlayFrameRows) -> list[LineDrawing]:
        """Return the trails of the targets in the image; without tracks in images, projections of those on the ground.

        Args:
            view: index of the view.
            frame: its image.
            rows: rows of the frame.
        """
        if self._world is not None:
            self._world.move(frame.t_ns)
        if rows.tracks is not None:
            return self._trails[view].ways(rows.tracks, frame.t_ns)
        camera = self._rig.cameras[view]
        if self._world is None or self._tracks is not None or camera is None or not camera.has_height:
            return []
        return self._world.ways(camera, frame.t_ns)

    def _shot(self, view: int, number: int, rows: list[OverlayFrameRows]) -> FrameDrawing:
        """Return what is drawn over one frame; true positions are boxes only if there are no estimates of the view.

        Args:
            view: index of the view.
            number: index of the frame.
            rows: rows of each view at this time.
        """
        shot = frame_shot(view, number, rows, self._rig)
        if self._lost.is_lost(self.names[view], number):
            shot = shot._replace(notes=[*shot.notes, NO_IMAGE])
        return shot._replace(boxed=shot.boxed and self._world is None)

    def _drawn(
        self,
        images: list[Image],
        numbers: list[int],
        rows: list[OverlayFrameRows],
        ways: list[list[LineDrawing]],
        t_ns: int,
    ) -> Image:
        shots = [
            self._shot(view, number, rows)._replace(ways=ways[view], ranks=self._ranks)
            for view, number in enumerate(numbers)
        ]
        pictures = [draw_shot(image, shot, self.scale) for image, shot in zip(images, shots, strict=True)]
        if self._plan is not None and self._world is not None:
            seconds = (t_ns - self._start) / NS
            pictures.append(self._plan.draw(self._world.crowd, self._world.true, t_ns, seconds))
        return tile(pictures, self._columns)


def _around(asked: OverlayRequest, scene: Scene | None) -> Floats:
    """Return the points (K, 2) in the world that the plan must contain: the room, or else the extent of the tracks.

    Empty if no plan is drawn.
    """
    if not asked.plan or asked.ground_tracks is None or scene is None:
        return np.zeros((0, 2))
    return extent_of(asked.ground_tracks) if scene.room is None else scene.room


def _columns(cells: int) -> int:
    return cells if cells <= 3 else math.ceil(math.sqrt(cells))


def _world(
    asked: OverlayRequest, recording: McapRecording, scene: Scene | None, ranks: Mapping[int, int], job: Job
) -> GroundTrackPositions | None:
    """Return a reader of tracks on the ground; None without such tracks, or without a scene.

    Args:
        asked: names the tracks, and their diagnostics and truth, if any.
        recording: has the cameras.
        scene: poses of cameras, and unit of length; None: unknown.
        ranks: index of the colour of each target.
        job: receives notes on what is not drawn.

    Raises:
        UsageError: there are tracks on the ground, but neither a scene nor tracks in images.
    """
    if asked.ground_tracks is None:
        return None
    if scene is None:
        why = f"{asked.ground_tracks}: tracks of the world are drawn where cameras are known: name a scene with --scene"
        if asked.tracks is None:
            raise UsageError(why)
        job.note(why)
        return None
    without = [c.name for c in scene.cameras if c.name in recording.cameras and not c.has_height]
    if asked.tracks is None and without:
        job.note(f"cameras of unknown height show no tracks of the world: {', '.join(without)}")
    metres = METRES.get(scene.length_unit, 1.0)
    return GroundTrackPositions(
        OverlayTables(asked.ground_tracks, asked.diagnostics, asked.truth, scene.length_unit),
        metres,
        ranks,
        asked.trail_s,
    )


def _first_image(recording: McapRecording, name: str, lost: LostFrames) -> Image:
    """Return the first decodable image of the camera `name`; InputError without one.

    Frames before it are recorded in `lost`, in place.
    """
    for frame in recording.frames([name]):
        image = lost.image(frame)
        if image is not None:
            return image
    raise InputError(
        f"{recording.path}: no image of camera {name} can be decoded; draw other cameras ({option('camera')})",
        id="damaged-file",
    )


def _rig(
    asked: OverlayRequest, recording: McapRecording, names: list[str], scene: Scene | None, lost: LostFrames, job: Job
) -> OverlayRig:
    """Return the views, with the sizes of their first images, and their epipolar geometry if tracks are drawn.

    The geometry comes from fundamental matrices or from poses, see `known_geometry`; None without tracks in images.

    Args:
        asked: names the tracks, and files with the scene and with fundamental matrices, if any.
        recording: the images.
        names: names of the cameras, one for each view.
        scene: has the cameras, for lens distortion; None: unknown.
        lost: records frames that cannot be decoded, in place.
        job: receives notes on the geometry.

    Raises:
        InputError: no image of a camera can be decoded.
    """
    cameras = [next((c for c in scene.cameras if c.name == name), None) if scene else None for name in names]
    sizes = [_first_image(recording, name, lost).shape for name in names]
    views = [TrackedView(name, size[1], size[0]) for name, size in zip(names, sizes, strict=True)]
    if asked.tracks is None:
        return OverlayRig(views, cameras, None)
    known = known_geometry(views, recording, scene if asked.scene is not None else None, asked.fundamental)
    for line in known.notes:
        job.note(line)
    bottom = read_provenance(asked.tracks).parameters.get("anchor") == "bottom"
    return OverlayRig(views, cameras, known.geometry, _numbered(asked), bottom)


def _numbered(asked: OverlayRequest) -> bool:
    """Return whether trackers have the numbers of their true targets.

    They have not if they were initiated by detections, or if failures are of targets not assigned by identity.
    """
    births = read_provenance(asked.tracks).parameters.get("births") if asked.tracks is not None else None
    failures = asked.failures
    own = read_provenance(failures).parameters.get("assigned_target") if failures is not None else None
    return births in (None, "initial") and own in (None, "id")


def _rows(path: Path | None, table: type[T]) -> FrameRowReader[T] | None:
    if path is None:
        return None
    return FrameRowReader(open_input(path).rows(table))


def _at(rows: FrameRowReader[T] | None, frame: Frame) -> T | None:
    return rows.at(frame.t_ns, frame.sensor) if rows is not None else None
