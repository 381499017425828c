"""Writing of the MCAP file for viewers, with its layout."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap_protobuf.schema import build_file_descriptor_set

from occlog import console
from occlog.array_types import NS
from occlog.errors import InputError
from occlog.examine.export.formats import FOXGLOVE, RERUN, VIEWERS
from occlog.examine.viewers.drawings.foxglove import image_annotations, image_cloud, point_cloud, scene_update
from occlog.examine.viewers.drawings.shapes import DrawingGroup, smaller
from occlog.examine.viewers.drawings.world import (
    camera_calibration,
    frame_transforms,
    plan,
    smaller_camera,
    static_shadows,
    world_of,
)
from occlog.io.files.atomic import OutputGroup, check_outputs, open_output
from occlog.io.files.inputs import hash_inputs
from occlog.io.files.provenance import Provenance
from occlog.io.frames.codec import check_image, encode_image, image_kind, shown_size
from occlog.io.open import input_losses
from occlog.io.recording.reader import linked_videos
from occlog.io.recording.writer import PROTOBUF, ROS2, RecordingWriter
from occlog.records.frames import Frame
from occlog.records.losses import Loss
from occlog.records.scene import Camera
from occlog.records.verdicts import texts_of

from .inputs import ViewerInputs, find_inputs, note_unexpected
from .layout import foxglove_layout
from .series import DEFINITION, MAIN, SCHEMA, main_columns, main_numbers
from .time_stream import (
    LAYERS,
    PARTICLES,
    ImageOverlay,
    LogLine,
    Numbers,
    SceneDrawing,
    StreamItem,
    Thinner,
    ViewerStream,
)

_LEVELS = {False: Log.Level.INFO, True: Log.Level.WARNING}
QUALITY = 90
"""JPEG quality of images that are extracted from videos or downscaled."""
HEIGHT = 720
"""Images higher than this are made smaller: images for viewing may be smaller than those for measurement [px]."""


@dataclass(frozen=True)
class ViewerTask:
    """Task of writing a viewer's file.

    Attributes:
        input: run folder, recording or table.
        output: the MCAP file.
        viewer: `foxglove`: scenes and annotations; `rerun`: point clouds, which Rerun draws instead; `viewers`: both.
        recording: None: that of the folder.
        scene: scene file; None: that of the recording.
        layout: path of a layout file for Foxglove; None: none is written.
        quality: quality of JPEG images from videos and of reduced images, 1 to 100.
        height: images higher than this are reduced [px].
        overwrite: replace existing outputs.
        every: least time between messages of a topic [s], counted from the first time; None: all are written.
    """

    input: Path
    output: Path
    viewer: str = VIEWERS
    recording: Path | None = None
    scene: Path | None = None
    layout: Path | None = None
    quality: int = QUALITY
    height: int = HEIGHT
    overwrite: bool = False
    every: float | None = None


def run_viewers(request: ViewerTask, *, quiet: bool = False) -> tuple[dict[str, object], tuple[Loss, ...]]:
    """Write the file for a viewer, and its layout; return summary and data losses.

    `quiet`: no notes and progress. InputError if there is nothing to show.
    """
    files = (request.input, request.recording, request.scene)
    check_outputs(files, (request.output, request.layout), request.overwrite)
    inputs = find_inputs(request.input, request.recording, request.scene)
    note_unexpected(inputs, quiet)
    story = ViewerStream(inputs)
    with OutputGroup() as together:
        writer = RecordingWriter(
            request.output, None, Provenance("export"), overwrite=request.overwrite, together=together
        )
        with writer as out:
            sink = _Sink(out, inputs, request)
            for item in console.progress(_begun(story.items(), sink, inputs), "write", quiet=quiet):
                sink.write(item)
            if not out.messages:
                why = "tracks and boxes in images need --recording" if inputs.recording is None else "tables are empty"
                raise InputError(f"{request.input}: there is nothing to show: {why}", id="wrong-content")
            losses = (*_previous_losses(inputs), *sink.losses)
            made = _provenance(inputs, request, losses)
            out.annotate(made)
            console.note_findings(texts_of(made.judged, "export"), quiet)
        if request.layout is not None:
            text = json.dumps(foxglove_layout(sink.topics, inputs.scene), indent=1) + "\n"
            with open_output(request.layout, request.overwrite, together) as file:
                file.write(text.encode())
    summary: dict[str, object] = {"output": str(request.output), "format": request.viewer}
    summary |= {} if request.layout is None else {"layout": str(request.layout)}
    summary |= {"topics": len(sink.topics), "messages": out.messages, "frames": sink.frames}
    return summary | {"targets": len(story.palette)}, losses


def _previous_losses(inputs: ViewerInputs) -> tuple[Loss, ...]:
    before = input_losses(inputs.opened)
    return (*before, *(() if inputs.recording is None else (x for x in inputs.recording.losses if x not in before)))


def _provenance(inputs: ViewerInputs, request: ViewerTask, losses: tuple[Loss, ...]) -> Provenance:
    paths = [opened.path for opened in inputs.opened]
    if inputs.recording is not None:
        paths += [inputs.recording.path, *linked_videos(inputs.recording.path)]
    paths += [] if request.scene is None else [request.scene]
    made: dict[str, object] = {"to": request.viewer, "quality": request.quality, "height": request.height}
    made |= {} if request.every is None else {"every": request.every}
    return Provenance("export", made, None, hash_inputs(dict.fromkeys(paths)), losses)


def _begun(items: Iterator[StreamItem], sink: _Sink, inputs: ViewerInputs) -> Iterator[StreamItem]:
    """Generate the items of the stream unchanged; at the time of the first one, static content is written to `sink`."""
    for n, item in enumerate(items):
        if not n:
            sink.begin(item.frame.t_ns if isinstance(item, ImageOverlay) else item.t_ns, inputs)
        yield item


class _Sink:
    """Encodes drawings for the requested viewer, and writes them as messages of an MCAP file."""

    def __init__(self, out: RecordingWriter, inputs: ViewerInputs, request: ViewerTask) -> None:
        self._out, self._inputs, self._request = out, inputs, request
        self._lines, self._points = request.viewer != RERUN, request.viewer != FOXGLOVE
        self._world = world_of(inputs.scene)
        self._cameras = {} if inputs.scene is None else {c.name: c for c in inputs.scene.cameras}
        self._calibrated: set[str] = set()
        self._plotted: dict[str, tuple[str, ...]] = {}  # by topic its columns
        self._thinner = None if request.every is None else Thinner(round(request.every * NS))
        self.topics: dict[str, str] = {}
        self.losses: list[Loss] = []
        self.frames = 0

    def begin(self, t_ns: int, inputs: ViewerInputs) -> None:
        """Write static content (poses, floor plan, shadows) and earlier losses at the time `t_ns` [ns]."""
        for loss in _previous_losses(inputs):
            self.write(LogLine(t_ns, True, "lost earlier", str(loss)))
        if inputs.scene is None:
            return
        self._message("/tf", FrameTransforms, t_ns, frame_transforms(inputs.scene, t_ns, inputs.metres))
        self.write(SceneDrawing("/plan", t_ns, plan(inputs.scene, inputs.metres)))
        if shadows := static_shadows(inputs.scene, inputs.metres):
            self.write(SceneDrawing("/static_shadows", t_ns, shadows))

    def write(self, item: StreamItem) -> None:
        """Write one item, unless messages are thinned and its topic had one in this time interval."""
        if self._thinner is not None and not self._thinner.keeps(item):
            return
        if isinstance(item, SceneDrawing) and item.topic == PARTICLES:
            data = point_cloud(item.things, item.t_ns, self._world)
            self._message(item.topic, PointCloud, item.t_ns, data)
        elif isinstance(item, SceneDrawing):
            if self._lines:
                data = scene_update(item.things, item.t_ns, self._world)
                self._message(item.topic, SceneUpdate, item.t_ns, data)
            if self._points:
                data = point_cloud(item.things, item.t_ns, self._world)
                self._message(self._second(item.topic), PointCloud, item.t_ns, data)
        elif isinstance(item, ImageOverlay):
            self._over(item)
        elif isinstance(item, Numbers):
            self._numbers(item)
        else:
            message = Log(level=_LEVELS[item.warns], message=item.words, name=item.source)
            message.timestamp.FromNanoseconds(item.t_ns)
            self._message("/log", Log, item.t_ns, message.SerializeToString(deterministic=True))

    def _second(self, topic: str) -> str:
        """Return the topic of Rerun's point cloud for the layer that `topic` shows.

        If lines are written as well, it is the same name without the leading slash: Rerun treats both as one.
        """
        return topic.removeprefix("/") if self._lines else topic

    def _numbers(self, item: Numbers) -> None:
        series = item.series
        if self._lines:
            data = series.message(item.values)
            self._add(item.topic, series.schema, lambda: series.descriptors, item.t_ns, data)
        if self._points and series.name in MAIN:
            names = self._plotted.setdefault(item.topic, main_columns(series, item.values))
            data = main_numbers(series, names, item.values)
            self._add(self._second(item.topic), SCHEMA, DEFINITION.encode, item.t_ns, data, ROS2)

    def _over(self, item: ImageOverlay) -> None:
        frame = item.frame
        try:
            data, kind, size, shrunk = self._image(frame)
        except InputError as error:
            self.losses.append(Loss(frame.sensor, f"frame {frame.index}", str(error), 1))
            return
        self.topics[f"/camera/{frame.sensor}/image"] = "foxglove.CompressedImage"
        self._out.image(frame.sensor, frame.t_ns, frame.index, data, kind)
        self.frames += 1
        camera = self._cameras.get(frame.sensor)
        if shrunk != 1.0:
            camera = None if camera is None else smaller_camera(camera, shrunk)
        if camera is not None and camera.placed and frame.sensor not in self._calibrated:
            self._calibrated.add(frame.sensor)
            calibration = camera_calibration(camera, size, frame.t_ns)
            self._message(f"/camera/{frame.sensor}/calibration", CameraCalibration, frame.t_ns, calibration)
        begun = [layer for layer in LAYERS.values() if f"/camera/{frame.sensor}/image/{layer}" in self.topics]
        for layer in dict.fromkeys([*begun, *item.layers]):
            things = [smaller(thing, shrunk) for thing in item.layers.get(layer, [])]
            self._layer(f"/camera/{frame.sensor}/image/{layer}", frame, things, camera)

    def _layer(self, topic: str, frame: Frame, things: list[DrawingGroup], camera: Camera | None) -> None:
        """Write the shapes of one layer over a frame; without shapes an empty message, which clears the layer.

        Args:
            topic: topic of the layer.
            frame: the image.
            things: shapes, in pixels.
            camera: for point clouds; None, or without a pose: none are written.
        """
        if self._lines:
            self._message(topic, ImageAnnotations, frame.t_ns, image_annotations(things, frame.t_ns))
        if self._points and camera is not None and camera.placed:
            data = image_cloud(things, frame.t_ns, frame.sensor, camera)
            self._message(self._second(topic), PointCloud, frame.t_ns, data)

    def _image(self, frame: Frame) -> tuple[bytes, str, tuple[int, int], float]:
        """Return the compressed image of a frame, its format, size (width, height) [px] and scale factor, at most 1.

        It is encoded again, as JPEG, only if it comes from a video or is reduced.
        """
        most = self._request.height
        if frame.encoded is not None:
            kind, size = image_kind(frame.encoded), shown_size(frame.encoded)
            if kind is not None and size is not None and size[1] <= most:
                check_image(frame.encoded, f"camera {frame.sensor}")
                return frame.encoded, kind, size, 1.0
        image = frame.decode()
        shrunk = min(1.0, most / image.shape[0])
        if shrunk < 1.0:
            size = (max(1, round(shrunk * image.shape[1])), most)
            image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        return encode_image(image, "jpeg", self._request.quality), "jpeg", (image.shape[1], image.shape[0]), shrunk

    def _message(self, topic: str, schema: Any, t_ns: int, data: bytes) -> None:
        def descriptors() -> bytes:
            described: bytes = build_file_descriptor_set(schema).SerializeToString(deterministic=True)
            return described

        self._add(topic, schema.DESCRIPTOR.full_name, descriptors, t_ns, data)

    def _add(
        self,
        topic: str,
        schema: str,
        described: Callable[[], bytes],
        t_ns: int,
        data: bytes,
        coded: tuple[str, str] = PROTOBUF,
    ) -> None:
        self.topics[topic] = schema
        self._out.message(topic, schema, described, t_ns, data, coded)
