"""Every reader of occlog behind one call: a file, next to it the files that it needs, and good ones to begin with.

A reader takes everything out of its file that a command would: header, rows, images, what was lost.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from occlog.errors import OcclogError
from occlog.ingest.rig import describe as describe_calibration
from occlog.io.files.geodetic import stated_origin
from occlog.io.files.tables.parquet import describe, first_rows, read_header, read_provenance, read_table
from occlog.io.files.texts.documents import read_json
from occlog.io.files.timing.frame_choice import FrameChoice
from occlog.io.files.timing.times import read_sidecar
from occlog.io.formats.boxes.mot_challenge import has_classes, read_marks
from occlog.io.formats.boxes.reader import BoxFile, BoxOptions, read_boxes, survey_boxes
from occlog.io.formats.calibration.common import CalibrationOptions
from occlog.io.formats.calibration.points import read_marked_points
from occlog.io.formats.calibration.reader import read_calibration
from occlog.io.formats.models.ellipses import read_ellipses
from occlog.io.formats.models.fundamental_matrices import read_epipolar, read_matches
from occlog.io.formats.models.motion_models import read_motion, read_path_loss
from occlog.io.formats.models.networks import read_network
from occlog.io.formats.models.onnx_file import read_onnx
from occlog.io.formats.positions import PositionOptions, parse_grid, read_positions
from occlog.io.formats.scenes.paths import read_paths
from occlog.io.formats.sound.csv_log import DoaOptions
from occlog.io.formats.sound.directions import read_doa
from occlog.io.formats.sound.formats import read_arrays
from occlog.io.formats.sound.wav import open_sound
from occlog.io.formats.tags import read_readers, read_reads
from occlog.io.formats.truth import TruthOptions, read_sync_times, read_truth
from occlog.io.frames.codec import decode_image, packet_size
from occlog.io.frames.streams import rate_times
from occlog.io.messages.bag import BagDecoder, BagSurvey, is_bag, open_bag, survey
from occlog.io.messages.contents import (
    FramePose,
    MessageBoxRows,
    direction_rows,
    intrinsics,
    pixels,
    stored,
    truth_rows,
)
from occlog.io.messages.kinds import BoxMessage, DirectionMessage, ImageMessage, InfoMessage, PoseMessage
from occlog.io.messages.topics import read_topic_map
from occlog.io.messages.video_stream import StreamReader, is_video
from occlog.io.open import open_input, scene_in
from occlog.io.recognition import contents_of, read_sequence_info
from occlog.io.recording.reader import open_recording
from occlog.io.recording.rows import RECORDED
from occlog.io.recording.salvage.recover import recover_recording
from occlog.io.video.reader import read_container
from occlog.pipeline.run.stages import read_config
from occlog.pipeline.sweep.plan import read_sweep
from occlog.records.scene import MicrophoneArray
from occlog.records.tables import TABLES, Boxes

from . import seeds
from .mutations import GZIP, MCAP, PARQUET, PNG, ZIP, ZSTD, Layer

RATE = rate_times(Fraction(10), "given")
SIZES = {"a": (64, 48), "b": (64, 48), "C1": (1920, 1080), "C2": (1920, 1080)}
ARRAYS = (MicrophoneArray("wall", np.zeros(3), yaw=0.5), MicrophoneArray("ceiling", np.ones(3), pitch=-0.3))


@dataclass(frozen=True)
class Reader:
    """A reader and what it is tried on.

    Attributes:
        name: of the reader.
        file: name of the file, perhaps in a folder, that changes are made in.
        read: reads the folder's file to its end.
        make: gives good files.
        layer: how the content of a container is changed.
        next to: other files of the folder.
        noisy: it decodes images, and what the libraries of these say of damage goes to standard error.
    """

    name: str
    file: str
    read: Callable[[Path], object]
    make: Callable[[], list[bytes]]
    layer: Layer | None = None
    beside: Mapping[str, bytes] = field(default_factory=dict)
    noisy: bool = False

    @cached_property
    def seeds(self) -> list[bytes]:
        """Good files."""
        return self.make()


def _drain(rows: Iterator[object]) -> None:
    for _ in rows:
        pass


def _recording(path: Path) -> None:
    recording = open_recording(path)
    for name in recording.attachments:
        recording.attachment(name)
    failures: list[OcclogError] = []
    for part in (*(partial(recording.read, table) for table in RECORDED), partial(_frames, recording.frames())):
        try:
            part()
        except OcclogError as error:
            failures.append(error)
    if failures:
        raise failures[0]


def _frames(frames: Iterator[object]) -> None:
    for frame in frames:
        frame.decode()  # type: ignore[attr-defined]


def _recover(path: Path) -> None:
    out = path.with_name("out.mcap")
    try:
        recover_recording(path, out, {"cam": path})
    finally:
        out.unlink(missing_ok=True)


def _bag(path: Path) -> None:
    is_bag(path)
    with open_bag([path]) as bag, stated_origin("52.5163,13.3777,0,30"):
        found = survey(bag, ())
        bag.span()
        for name, info in found.infos.items():
            intrinsics(info, rectified=False, where=f"{path}: {name}")
        messages, boxes = BagDecoder(found.topics), MessageBoxRows("a", (), 1.0)
        for message in bag.messages(set(found.topics)):
            with suppress(OcclogError):  # which is a loss
                _message(messages.read(message.topic, message.data), found, boxes)
        _ = bag.losses


def _message(content: object, found: BagSurvey, boxes: MessageBoxRows) -> None:
    """Do with a message what ingesting does."""
    if isinstance(content, ImageMessage) and is_video(content.encoding):
        StreamReader(content.encoding).read(content.data)
    elif isinstance(content, ImageMessage):
        stored(content, "image", "png", 90)
        pixels(content, "image")
    elif isinstance(content, InfoMessage):
        intrinsics(content, rectified=True, where="info")
    elif isinstance(content, PoseMessage):
        truth_rows(content, 1, 0, FramePose(np.eye(3), np.zeros(3)))
    elif isinstance(content, BoxMessage):
        boxes.rows(content, 1)
    elif isinstance(content, DirectionMessage):
        direction_rows(content, 1, ARRAYS[1])
    elif isinstance(content, list):
        for one in content:
            root = found.transforms.still_root(one.child)
            found.transforms.placed(one.child, root)


def _table(path: Path) -> None:
    describe(path)
    first_rows(path, 5)
    read_header(path)
    read_provenance(path)
    opened = open_input(path, *TABLES.values())
    read_table(path, TABLES[opened.table])


def _foreign(path: Path) -> None:
    opened = open_input(path)
    _drain(opened.rows(TABLES[opened.table]))


def _on_earth(path: Path) -> None:
    with stated_origin("52.5163,13.3777,0,30"):
        _foreign(path)


def _stream(path: Path) -> None:
    """Messages of 16 to 255 bytes of a stream, the first byte of a file states H.264 or H.265."""
    data = path.read_bytes()
    reader, at = StreamReader("h265" if data[:1] == b"5" else "h264"), 1
    while at < len(data):
        size = data[at] or 1
        with suppress(OcclogError):  # which is a loss
            reader.read(data[at + 1 : at + 1 + size])
        at += 1 + size


def _boxes(camera: str | None, folder: bool, path: Path) -> None:
    options = BoxOptions(classes=(), sizes=SIZES, drop_zero=True)
    given = [BoxFile(path.parent if folder else path, camera)]
    found = survey_boxes(given, (), options)
    times = {**dict.fromkeys(found.cameras, RATE), **found.times}
    if (found.stop - found.first) * max(len(found.cameras), 1) > 100_000:
        return  # a row for each frame, which takes its time
    _drain(read_boxes(given, found, times, (), options, Boxes))


def _positions(path: Path) -> None:
    read_positions(path, PositionOptions(times={"": RATE}, grid=parse_grid("0.025,-3,-9")))


def _truth(path: Path) -> None:
    options = TruthOptions(
        cameras=("a", "b"), camera="a", times={"a": RATE, "b": RATE}, sync_ns=dict.fromkeys(range(9), 7),
        boxes=BoxOptions(sizes=SIZES, frames=FrameChoice((0, 100))),
    )  # fmt: skip
    _drain(read_truth(path, options))


def _calibration(folder: bool, path: Path) -> None:
    options = CalibrationOptions(image_size=(640, 480), unit="m")
    describe_calibration(read_calibration([path.parent if folder else path], options=options))


def _marked_points(path: Path) -> None:
    read_marked_points(path, ["cam1", "cam2"])


def _doa(path: Path, sensor: str | None = "wall") -> None:
    options = DoaOptions(sensor=sensor, hop=Fraction(128, 16000), convention="array")
    _drain(read_doa(path, ARRAYS, options, losses=[]))


def _sound(path: Path) -> None:
    sound = open_sound(path)
    _drain(sound.blocks(4096))
    _ = sound.losses


def _image(path: Path) -> None:
    data = path.read_bytes()
    packet_size(data)
    decode_image(data, str(path))


def _packet(path: Path) -> None:
    packet_size(path.read_bytes())


READERS = {
    reader.name: reader
    for reader in (
        Reader("recording", "r.mcap", _recording, seeds.recordings, MCAP, noisy=True),
        Reader("recover", "r.mcap", _recover, seeds.recordings, MCAP),
        Reader("bag (MCAP)", "b.mcap", _bag, seeds.bags, MCAP, noisy=True),
        Reader("bag (Foxglove)", "b.mcap", _bag, seeds.foxglove_bags, MCAP, noisy=True),
        Reader("bag (SQLite)", "b.db3", _bag, seeds.databases, noisy=True),
        Reader("bag (ROS 1)", "b.bag", _bag, seeds.bags_of_ros_1, noisy=True),
        Reader("bag (zstd)", "b.mcap.zstd", _bag, seeds.packed_bags, ZSTD, noisy=True),
        Reader(
            "bag (metadata)", "bag/metadata.yaml", lambda path: _bag(path.parent), seeds.text(seeds.METADATA),
            beside={"bag/b.mcap": b"\x89MCAP0\r\n"},
        ),
        Reader("table", "t.parquet", _table, seeds.tables, PARQUET),
        Reader("foreign table (Arrow)", "t.parquet", _foreign, seeds.foreign_tables),
        Reader("foreign table (Parquet)", "t.parquet", _foreign, lambda: seeds.foreign_tables()[:1], PARQUET),
        Reader("foreign table (text)", "t.csv", _foreign, seeds.text(seeds.TRUTH, seeds.TRACKS, seeds.DOA)),
        Reader("foreign table (gzip)", "t.csv.gz", _foreign, seeds.packed(seeds.TRUTH, seeds.TRACKS), GZIP),
        Reader("trajectories (TUM)", "t.tum", _foreign, seeds.text(seeds.TUM)),
        Reader("trajectories (GPX)", "t.gpx", _on_earth, seeds.text(seeds.GPX)),
        Reader("table on the earth", "t.csv", _on_earth, seeds.text(seeds.GPS)),
        Reader(
            "trajectories (KITTI)", "t.txt", _foreign, seeds.text(seeds.KITTI_POSES),
            beside={"times.txt": b"0.0\n1.0e-01\n"}, noisy=True,
        ),
        Reader("stream of video", "v.bin", _stream, seeds.streams),
        Reader("trajectories (TRC)", "t.trc", _foreign, seeds.text(seeds.TRC)),
        Reader("trajectories (GeoJSON)", "t.geojson", _foreign, seeds.text(seeds.GEOJSON)),
        Reader("scene", "s.yaml", scene_in, seeds.scenes),
        Reader("stations", "s.csv", scene_in, seeds.text(*seeds.STATIONS)),
        Reader("paths", "p.yaml", read_paths, seeds.examples("examples/lee_field_paths.yaml")),
        Reader(
            "run", "r.yaml", read_config, seeds.examples("sample_data/room/run.yaml", "sample_data/pose2sim/run.yaml")
        ),
        Reader("sweep", "s.yaml", read_sweep, seeds.examples("examples/sweep.yaml")),
        Reader("network", "n.yaml", read_network, seeds.text(seeds.NETWORK)),
        Reader("topics", "t.yaml", read_topic_map, seeds.text(*seeds.TOPICS)),
        Reader("boxes (CSV)", "b.csv", partial(_boxes, None, False), seeds.text(seeds.BOXES)),
        Reader("boxes (MOT)", "b.txt", partial(_boxes, "a", False), seeds.text(seeds.MOT)),
        Reader("boxes (KITTI)", "b.txt", partial(_boxes, "a", False), seeds.text(seeds.KITTI)),
        Reader("boxes (CVAT)", "b.xml", partial(_boxes, "a", False), seeds.text(*seeds.CVAT)),
        Reader("boxes (VATIC)", "b.txt", partial(_boxes, "a", False), seeds.text(seeds.VATIC)),
        Reader(
            "boxes (JSON)", "b.json", partial(_boxes, "a", False), seeds.text(seeds.COCO, seeds.GIVEN, seeds.DETECTIONS)
        ),
        Reader("boxes (WILDTRACK)", "w/00000000.json", partial(_boxes, None, True), seeds.text(seeds.WILDTRACK)),
        Reader("boxes (YOLO)", "y/000002.txt", partial(_boxes, "a", True), seeds.text(seeds.YOLO)),
        Reader("classes", "gt.txt", lambda p: has_classes(p) and read_marks(p), seeds.text("1,1,1,2,3,4,1,1,0.5\n")),
        Reader(
            "truth", "g.csv", _truth,
            seeds.text(seeds.TRUTH, seeds.BOXES, seeds.MOT, "frame,x,y\n0,1,2\n7,3,4\n", seeds.VATIC, seeds.KITTI),
        ),
        Reader("truth (XML)", "g.xml", _truth, seeds.text(seeds.XML)),
        Reader("truth (board)", "xyz.csv", _truth, seeds.text(seeds.BOARD)),
        Reader("truth (LOCATA)", "position_source_talker3.txt", _truth, seeds.text(seeds.LOCATA_SOURCE)),
        Reader("truth (WILDTRACK)", "w/00000000.json", lambda p: _truth(p.parent), seeds.text(seeds.WILDTRACK)),
        Reader("sequence", "seqinfo.ini", read_sequence_info, seeds.text(seeds.SEQUENCE)),
        Reader("recognition", "f.txt", contents_of, seeds.text(seeds.MOT, seeds.BOXES, seeds.DOA, seeds.SEQUENCE)),
        Reader("recognition (XML)", "f.xml", contents_of, seeds.text(*seeds.CVAT, seeds.TSAI)),
        Reader("positions", "p.csv", _positions, seeds.text(seeds.POSITIONS)),
        Reader("synchronisation", "timestamps.csv", read_sync_times, seeds.text(seeds.SYNC)),
        Reader("time stamps", "t.csv", lambda path: read_sidecar(path, ("a", "b")), seeds.text(*seeds.TIMES)),
        Reader("directions (CSV)", "d.csv", lambda path: _doa(path, None), seeds.text(seeds.DOA)),
        Reader("directions (ODAS)", "d.json", _doa, seeds.text(seeds.ODAS), noisy=True),
        Reader("directions (FRIDA)", "d.csv", _doa, seeds.text(seeds.FRIDA)),
        Reader("directions (telemetr)", "d.dat", _doa, seeds.text(seeds.TELEMETR)),
        Reader("arrays", "a.csv", read_arrays, seeds.text("x,y,z\n0,0,1\n0.1,0,1\n", "1 2\n3 4\n", seeds.LOCATA)),
        Reader("sound", "s.wav", _sound, seeds.sounds),
        Reader("tag readers", "r.csv", read_readers, seeds.text(seeds.READERS)),
        Reader("tag reads", "r.csv", lambda path: read_reads(path, ("A", "B")), seeds.text(seeds.READS)),
        Reader(
            "ellipses", "e.csv", lambda path: read_ellipses(path, {"view1": (160, 120)}, ("view1", "view2")),
            seeds.text(seeds.ELLIPSES),
        ),
        Reader("matches", "m.csv", read_matches, seeds.text(seeds.MATCHES)),
        Reader("motion", "m.json", read_motion, seeds.text(seeds.MOTION)),
        Reader("epipolar", "e.json", read_epipolar, seeds.text(seeds.EPIPOLAR)),
        Reader("path losses", "p.json", read_path_loss, seeds.text(seeds.PATH_LOSS)),
        Reader("metrics", "m.json", read_json, seeds.text(seeds.METRICS)),
        Reader("network (ONNX)", "n.onnx", read_onnx, seeds.networks),
        Reader(
            "calibration (storage, YAML)", "c.yml", partial(_calibration, False), lambda: [seeds.storage(".yml")]
        ),
        Reader("calibration (storage, XML)", "c.xml", partial(_calibration, False), lambda: [seeds.storage(".xml")]),
        Reader("calibration (storage, JSON)", "c.json", partial(_calibration, False), lambda: [seeds.storage(".json")]),
        Reader(
            "calibration (pairs)", "c/intr_a.xml", partial(_calibration, True),
            lambda: [seeds.storage(".xml", place=False)], beside={"c/extr_a.xml": seeds.storage(".xml", lens=False)},
        ),
        Reader("calibration (TOML)", "c.toml", partial(_calibration, False), seeds.text(seeds.TOML)),
        Reader("calibration (homography)", "cam1_H.txt", partial(_calibration, False), seeds.text(seeds.HOMOGRAPHY)),
        Reader("marked points", "p.csv", _marked_points, seeds.text(seeds.MARKED_POINTS)),
        Reader("calibration (projection)", "cam1_P.txt", partial(_calibration, False), seeds.text(seeds.PROJECTION)),
        Reader(
            "calibration (Qualisys)", "c.qca.txt", partial(_calibration, False),
            seeds.examples("sample_data/pose2sim/Calib.qca.txt"),
        ),
        Reader("calibration (Tsai)", "c.xml", partial(_calibration, False), seeds.text(seeds.TSAI)),
        Reader("calibration (Kalibr)", "camchain.yaml", partial(_calibration, False), seeds.text(seeds.KALIBR)),
        Reader("calibration (ROS)", "c.yaml", partial(_calibration, False), seeds.text(seeds.ROS)),
        Reader(
            "calibration (COLMAP, cameras)", "c/cameras.txt", partial(_calibration, True),
            seeds.text(seeds.COLMAP_CAMERAS), beside={"c/images.txt": seeds.COLMAP_IMAGES.encode()},
        ),
        Reader(
            "calibration (COLMAP, images)", "c/images.txt", partial(_calibration, True),
            seeds.text(seeds.COLMAP_IMAGES), beside={"c/cameras.txt": seeds.COLMAP_CAMERAS.encode()},
        ),
        Reader("calibration (npz)", "c.npz", partial(_calibration, False), seeds.arrays("npz"), ZIP),
        Reader("calibration (npy)", "c.npy", partial(_calibration, False), seeds.arrays("npy")),
        Reader("calibration (MATLAB)", "c.mat", partial(_calibration, False), seeds.arrays("mat")),
        Reader("image (PNG)", "i.png", _image, seeds.images(".png"), PNG, noisy=True),
        Reader("image (JPEG)", "i.jpg", _image, seeds.images(".jpg"), noisy=True),
        Reader("packet (H.264, VP8)", "p.bin", _packet, seeds.packets),
        Reader("video (AVI)", "v.avi", read_container, seeds.videos_avi),
        Reader("video (MP4)", "v.mp4", read_container, seeds.videos_mp4),
        Reader("video (Matroska)", "v.mkv", read_container, seeds.videos_mkv),
    )
}  # fmt: skip
"""Every reader by its name."""
