"""Inputs of tracking in images: frames, initial ellipses, detections, epipolar geometry.

Provenance of tracks made from video: where their trackers came from, and from which recording.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path

from occlog import console
from occlog.console.notes import threads_by_default
from occlog.errors import InputError, UsageError, did_you_mean, option
from occlog.io.files.provenance import Provenance, hash_file
from occlog.io.formats.models.ellipses import FIRST, GivenEllipse, read_ellipses
from occlog.io.formats.models.motion_models import model_losses
from occlog.io.open import Opened, input_losses, load_scene, open_if_ours, open_input
from occlog.io.recording.reader import McapRecording
from occlog.measure.epipolar.matrices import known_geometry
from occlog.records.declared.views import ViewTracks
from occlog.records.losses import Loss
from occlog.records.scene import Camera, Scene
from occlog.records.tables import Bearings, Boxes, TruthBoxes, Views
from occlog.track.methods.images.ground.config import STARTS, GroundConfig
from occlog.track.methods.images.ground.stage import GroundTracksPart, ground_tracks
from occlog.track.methods.images.initiation.config import ViewsConfig
from occlog.track.methods.images.initiation.regions import (
    BackgroundModel,
    DetectorRegions,
    RegionStream,
    background_models,
    moving_regions,
    regions_of_boxes,
    regions_of_views,
    with_cameras,
)
from occlog.track.request import ViewsRequest

from .frame_synchronisation import step_window, survey
from .stage import TrackerStart

LARGE_ID = 2**30
"""Identities from here on leave few free numbers above them, fewer than there may be between others."""


class ViewsInput:
    """Inputs of a run that tracks in images: recording, scene, views, epipolar geometry, and where trackers start.

    `surveyed` has image size and frame period of each view, `window_ns` the default time window of a step, `given` the
    number of initial ellipses, counted by `starts`.
    """

    def __init__(self, request: ViewsRequest, stage: ViewsConfig) -> None:
        """Open the request's recording, and read scene, geometry and the first frames of every camera.

        Args:
            request: the files and the cameras to use.
            stage: settings of image conversion, births and ends.
        """
        self.request, self.stage = request, stage
        self.given = 0  # initial ellipses
        self.opened, self.recording = open_video(request)
        self._initial: Opened | None = None
        self._detections: Opened | None = None
        given = None if request.scene is None else load_scene(request.scene, None, request.scene)
        self.scene: Scene | None = given if given is not None else self.recording.scene
        self.names = choose_views(self.recording, request.cameras, request.without)
        self.surveyed = tuple(
            survey(name, self.recording.frames([name]), self._camera(name), bits=stage.bit_depth) for name in self.names
        )
        self.views = tuple(s.view for s in self.surveyed)
        self.window_ns = step_window(s.period_ns for s in self.surveyed)
        self.known = known_geometry(self.views, self.recording, given, request.fundamental)
        self.geometry = self.known.geometry

    @property
    def losses(self) -> tuple[Loss, ...]:
        """Return the losses recorded when the recording, initial ellipses, detections and matrices were made."""
        found = input_losses([self.opened, self._initial, self._detections])
        return tuple(dict.fromkeys((*found, *model_losses([self.request.fundamental]))))

    @property
    def length_unit(self) -> str:
        """Return the length unit of the scene; "m" without a scene."""
        return "m" if self.scene is None else self.scene.length_unit

    @property
    def frames(self) -> int:
        """Return the number of image and video messages of the selected cameras, as the recording's index states it."""
        wanted = {f"/camera/{name}/{kind}" for name in self.names for kind in ("image", "video")}
        return sum(t.messages for t in self.recording.topics if t.name in wanted)

    def _camera(self, name: str) -> Camera | None:
        """Return the scene's camera of this name; None if the scene does not have it or there is no scene."""
        return next((c for c in self.scene.cameras if c.name == name), None) if self.scene is not None else None

    def _placed(self) -> list[str]:
        """Return the names of the selected cameras with a pose in the scene."""
        return [c.name for c in map(self._camera, self.names) if c is not None and c.placed]

    def on_ground(self, tracks: Iterable[ViewTracks], window_ns: int) -> Iterator[GroundTracksPart]:
        """Generate world tracks triangulated from image tracks, in parts; nothing without a scene.

        Args:
            tracks: image tracks in the order of time, chunk by chunk.
            window_ns: frames at most this far apart [ns] are one time step.
        """
        if self.scene is None:
            return iter(())
        config = GroundConfig(window_s=window_ns / 1e9, initial_switch_probability=STARTS.get(self.request.births, 0.0))
        return ground_tracks(tracks, self.scene, config, self._placed())

    def check_world(self) -> None:
        """Raise InputError if no camera has a pose, so that no ground position can be computed."""
        if not self._placed():
            raise InputError(
                f"{self.request.bearings}: no camera has a pose, so there are no ground positions; give a scene with "
                f"poses, or leave {option('ground_tracks')} out",
                id="missing-pose",
            )

    def starts(self) -> tuple[tuple[TrackerStart, ...], int]:
        """Return the trackers to start from the file of initial ellipses, sorted by frame, and the first free identity.

        Without such a file, no trackers and 0. InputError if a frame named there does not exist.
        """
        if self.request.initial_ellipses is None:
            return (), 0
        sizes = {view.name: (view.width, view.height) for view in self.views}
        given = read_ellipses(self.request.initial_ellipses, sizes, self.recording.cameras)
        self._initial = open_if_ours(self.request.initial_ellipses)
        if self._initial is None:
            self._check_frames(given)  # tables may be of a longer recording
        index_of = {name: v for v, name in enumerate(self.names)}
        starts = [TrackerStart(index_of[g.sensor], max(g.frame, 0), g.target_id, g.ellipse) for g in given]
        starts.sort(key=lambda s: (s.frame, s.view, s.target_id))
        self.given = len(starts)
        return tuple(starts), first_free([s.target_id for s in starts])

    def _check_frames(self, given: tuple[GivenEllipse, ...]) -> None:
        """Raise InputError if a first ellipse names a frame number that its camera does not have."""
        for name, known in zip(self.names, self.surveyed, strict=True):
            asked = [g for g in given if g.sensor == name and g.frame not in (FIRST, known.first)]
            if not asked:
                continue
            found = survey(name, self.recording.frames([name]), None, {g.frame for g in asked}, self.stage.bit_depth)
            for each in asked:
                if each.frame in found.missing:
                    raise InputError(
                        f"{each.where}: frame {each.frame} of target {each.target_id}: camera {name} has no such "
                        f"frame; it has {known.first} to {found.last}; correct it",
                        id="disjoint-inputs",
                    )

    def background(self, quiet: bool) -> tuple[BackgroundModel | None, ...]:
        """Return the background models of the views, learned in a first pass; empty unless the settings request them.

        `quiet`: do not show progress.
        """
        if not self.stage.background:
            return ()
        frames = console.progress(self.recording.frames(self.names), "first frames", self.frames, quiet=quiet)
        return background_models(frames, with_cameras(self.scene, self.views), self.views, threads_by_default())

    def region_stream(self) -> RegionStream | None:
        """Return the stream of detected regions that start and end trackers; None if there are initial ellipses only.

        Regions come from the file of detections, else from boxes in the recording, else from moving foreground.
        """
        path = self.request.detections
        if path is not None:
            return self._given(path)
        if self.request.initial_ellipses is not None:
            return None
        if self.recording.has(Boxes):
            return RegionStream(regions_of_boxes(self.recording.tables(Boxes), self.stage.birth_min_confidence), False)
        regions = moving_regions(
            lambda: self.recording.frames(self.names), self.scene, self.views, threads_by_default()
        )
        return RegionStream(regions, True)

    def _given(self, path: Path) -> RegionStream:
        """Return the regions in a file of detections at `path`: clusters or boxes, also boxes of the truth."""
        self._detections = opened = open_input(path)
        if opened.recording is None and opened.has(Views):
            return RegionStream(regions_of_views(opened.rows(Views)), True)
        if opened.recording is None and opened.has(TruthBoxes):
            return self._of_boxes(opened.rows(TruthBoxes))
        if opened.recording is None:
            opened.require(Boxes, Views)
        return self._of_boxes(opened.rows(Boxes))

    def _of_boxes(self, chunks: Iterator[Boxes]) -> RegionStream:
        """Return the stream of regions in a detector's boxes; frames without a row count as not processed."""
        regions: Iterator[DetectorRegions] = regions_of_boxes(chunks, self.stage.birth_min_confidence)
        return RegionStream(regions, False)


def first_free(taken: Sequence[int]) -> int:
    """Return the first of a range of free identities: after the largest taken one, or else in the largest gap.

    Args:
        taken: identities of targets, from 0 to 2^31 - 1.
    """
    ids = sorted({-1, *taken})
    if ids[-1] < LARGE_ID:
        return ids[-1] + 1
    gaps = [after - before for before, after in pairwise([*ids, 2**31])]
    return ids[gaps.index(max(gaps))] + 1


def open_video(request: ViewsRequest) -> tuple[Opened, McapRecording]:
    """Open the request's recording; InputError unless it is a recording (.mcap) with images."""
    path, method = request.bearings, request.method
    opened = open_if_ours(path)
    if opened is None or opened.recording is None:
        raise InputError(
            f"{path}: is not a recording (.mcap); method {method} tracks in images: give a recording with video, "
            "made with `occlog ingest` or `occlog simulate`",
            id="wrong-content",
        )
    recording = opened.recording
    if not recording.cameras:
        other = "track its bearings with another method, for example apf"
        if recording.has(Boxes) and not recording.has(Bearings):
            other = "track all people by its boxes with method jipda, which wants cameras with a calibration"
        raise InputError(
            f"{path}: holds no images; method {method} tracks in images: give a recording with video, or {other}",
            id="wrong-content",
        )
    return opened, recording


def choose_views(recording: McapRecording, only: tuple[str, ...], without: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of the cameras to track in, in the recording's order.

    `only`: these alone (empty: all); `without`: not these. UsageError for one that has no images, or if none is left.
    """
    for name in (*only, *without):
        if name not in recording.cameras:
            raise UsageError(
                f"{recording.path}: no images of camera {name!r}; {did_you_mean(name, recording.cameras, 'it has')}",
                id="unknown-sensor",
            )
    names = tuple(n for n in recording.cameras if (not only or n in only) and n not in without)
    if not names:
        raise UsageError(f"{option('without')}: no camera is left to track in; exclude fewer", id="too-few-sensors")
    return names


FROM_DETECTIONS = "trackers were initiated from detections, so that their numbers are not those of targets"


def video_provenance(tracks: Path | None) -> Provenance | None:
    """Return the provenance of a table that `occlog track` made from video; None for other tables."""
    opened = None if tracks is None else open_if_ours(tracks)
    if opened is None or opened.recording is not None:
        return None
    made = opened.provenance
    return made if made.command == "track" and "births" in made.parameters else None


def initiated_from_detections(tracks: Path | None) -> bool:
    """Return whether a table of tracks from video has trackers that were started from detections.

    False for None and for tables that `occlog track` did not make from video.
    """
    made = video_provenance(tracks)
    return made is not None and made.parameters["births"] != "initial"


def independent_id_note(tracks: Path | None, own: str, asked: str | None) -> list[str]:
    """Return a note for `--assigned-target` where trackers were started from detections, else an empty list.

    Their identities are then not those of the targets, so that assignment by identity is meaningless. No note either if
    --assigned-target has another value than `id`.

    Args:
        tracks: file of the tracks; None: there is none.
        own: value of --assigned-target in use.
        asked: value of --assigned-target as given; None: not given.
    """
    if not initiated_from_detections(tracks) or asked not in (None, "id"):
        return []
    how = f"--assigned-target {own} is used" if asked is None else "FR needs --assigned-target start"
    return [f"{tracks}: {FROM_DETECTIONS}; {how}"]


def other_video(tracks: Path | None, recordings: Iterable[Path | None]) -> list[str]:
    """Return a note for each recording with video that is not the one the tracks were made from.

    Two recordings may have the same times and cameras; a copy is another file too, so this is no error.

    Args:
        tracks: the tracks; tables that `occlog track` did not make from recordings are not judged.
        recordings: files that belong to the tracks, as given by the user; those without video are passed over.
    """
    made = video_provenance(tracks)
    inputs = made.inputs if made is not None else ()
    names = ", ".join(name for name, _ in inputs if name.lower().endswith(".mcap"))
    if not names:
        return []
    used = {digest for _, digest in inputs}
    return [
        f"{path}: {tracks} was made from another file ({names}); right only if both are of the same video"
        for path in dict.fromkeys(recordings)
        if path is not None and _has_video(path) and hash_file(path) not in used
    ]


def _has_video(path: Path) -> bool:
    """Return whether a file is a recording with images."""
    opened = open_if_ours(path)
    return opened is not None and opened.recording is not None and bool(opened.recording.cameras)
