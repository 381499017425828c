"""Small good files of every format that occlog reads, which the fuzzing changes."""

from __future__ import annotations

import gzip
import io
import json
import struct
import tempfile
from base64 import b64encode
from collections.abc import Callable
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.feather as feather
import pyarrow.parquet as pq
import ros1_bags
import ros_bags
import stream_samples
import zstandard
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from mcap.writer import Writer
from places import EXAMPLES, ROOT
from random_tables import random_table
from scipy.io import savemat
from small_networks import constant_network
from unindexed import unindexed
from video_samples import avi, faststart, fragmented, jpeg, write_video

from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.scenes.scene import read_scene
from occlog.io.recording.rows import RECORDED
from occlog.io.recording.writer import RecordingWriter
from occlog.records.losses import Loss
from occlog.records.tables import TABLES

MADE = Provenance("ingest", {"fps": 10}, 1, (("a.csv", "ab" * 32),), (Loss("a", "frame 7", "cut", 1),), ("box m",))


def file(make: Callable[[Path], object], name: str = "seed") -> bytes:
    """What a function writes."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        make(path)
        return path.read_bytes()


def text(*parts: str) -> Callable[[], list[bytes]]:
    """Texts as they stand here."""
    return lambda: [part.encode() for part in parts]


def examples(*names: str) -> Callable[[], list[bytes]]:
    """Files of the repository."""
    return lambda: [(ROOT / name).read_bytes() for name in names]


def scenes() -> list[bytes]:
    """Scenes of all kinds of sensors."""
    return [(EXAMPLES / f"{name}.yaml").read_bytes() for name in ("room", "arrays", "readers", "lee_space")]


@cache
def _recording(stored: str) -> bytes:
    """A recording with every table, a scene and images."""

    def make(path: Path) -> None:
        with RecordingWriter(path, read_scene(EXAMPLES / "arrays.yaml"), MADE) as writer:
            for n in range(3):
                data = cv2.imencode(f".{stored}", np.full((6, 8, 3), 40 * n, np.uint8))[1].tobytes()
                writer.image("cam", 10**9 + n * 10**8, n, data, stored)
            for kind in RECORDED:
                writer.table(random_table(kind, 3))

    return file(make, "r.mcap")


def recordings() -> list[bytes]:
    """Recordings of occlog, and one as if it were of a writer that makes no index."""
    return [_recording("png"), _recording("jpg"), unindexed(_recording("png"))]


def bags() -> list[bytes]:
    """Bags in MCAP: of one kind of message each, since every definition of a type takes its time."""
    t = ros_bags.START
    cameras = ros_bags.two_cameras(2)
    kinds = [
        [row for row in cameras if row[0].startswith("/cam_front/image")],
        [row for row in cameras if row[0] == "/tf_static"],
        [row for row in cameras if row[0].startswith("/cam_front/camera_info")],
        [("/b", "vision_msgs/msg/Detection2DArray", t, ros_bags.detections(t, (1.0, 2.0, 10.0, 20.0, 0.9, "p", "7")))],
        [("/odas", "odas_ros_msgs/msg/OdasSstArrayStamped", t, ros_bags.sounds(t, (1, 0.6, 0.8, 0.0, 0.5)))],
        [("/p", "geometry_msgs/msg/PoseStamped", t, ros_bags.pose(t, "map", (1, 2, 3)))],
        [("/gps/fix", "sensor_msgs/msg/NavSatFix", t, ros_bags.fix(t, 52.5163, 13.3777, 30.0))],
        [("/raw/image", "sensor_msgs/msg/Image", t, _raw("rgb8", 3))],
        [("/bayer/image", "sensor_msgs/msg/Image", t, _raw("bayer_rggb8", 1))],
    ]
    whole = [file(lambda path, rows=rows: ros_bags.write_mcap(path, rows)) for rows in kinds]
    return [*whole, file(lambda path: ros_bags.write_mcap(path, kinds[5], finish=False))]


def foxglove_bags() -> list[bytes]:
    """Bags of Foxglove's types, in JSON and in protobuf."""
    stamp = {"sec": 1_700_000_000, "nsec": 5}
    image = {
        "timestamp": stamp,
        "frame_id": "a",
        "width": 2,
        "height": 2,
        "encoding": "mono8",
        "step": 2,
        "data": "AAAAAA==",
    }
    info = {
        "timestamp": stamp, "frame_id": "a", "width": 64, "height": 48, "distortion_model": "plumb_bob", "D": [0.1, 0],
        "K": [50, 0, 31.5, 0, 50, 23.5, 0, 0, 1], "R": [1, 0, 0, 0, 1, 0, 0, 0, 1],
        "P": [50, 0, 31.5, 0, 0, 50, 23.5, 0, 0, 0, 1, 0],
    }  # fmt: skip
    pose = {
        "timestamp": stamp, "parent_frame_id": "map", "child_frame_id": "a", "translation": {"x": 1, "y": 2, "z": 3},
        "rotation": {"x": 0, "y": 0, "z": 0, "w": 1},
    }  # fmt: skip
    fix = {"timestamp": stamp, "frame_id": "a", "latitude": 52.5163, "longitude": 13.3777, "altitude": 30.5}
    packed = CompressedImage(frame_id="a", data=jpeg(0, (16, 16)), format="jpeg")
    packed.timestamp.FromNanoseconds(10**9)
    kinds = [
        ("foxglove.RawImage", "json", json.dumps(image).encode()),
        ("foxglove.CameraCalibration", "json", json.dumps(info).encode()),
        ("foxglove.FrameTransform", "json", json.dumps(pose).encode()),
        ("foxglove.CompressedVideo", "json", video_message(0)),
        ("foxglove.LocationFix", "json", json.dumps(fix).encode()),
        ("foxglove.CompressedImage", "protobuf", packed.SerializeToString()),
    ]

    return [foxglove_bag(kinds)]


def video_message(number: int) -> bytes:
    """A picture of a stream of H.264 as `foxglove.CompressedVideo` in JSON."""
    stamp, data = {"sec": 1_700_000_000 + number, "nsec": 5}, b64encode(stream_samples.H264[number]).decode()
    return json.dumps({"timestamp": stamp, "frame_id": "a", "format": "h264", "data": data}).encode()


def foxglove_bag(messages: list[tuple[str, str, bytes]]) -> bytes:
    """A bag of messages: type, encoding and data; a topic for each type."""

    def make(path: Path) -> None:
        with path.open("wb") as target:
            writer, channels = Writer(target), dict[str, int]()
            writer.start()
            for n, (kind, encoding, data) in enumerate(messages):
                if kind not in channels:
                    schema = writer.register_schema(kind, "jsonschema" if encoding == "json" else encoding, b"{}")
                    channels[kind] = writer.register_channel(f"/{kind}", encoding, schema)
                writer.add_message(channels[kind], 10**9 + n, data, 10**9)
            writer.finish()

    return file(make)


def _raw(encoding: str, depth: int) -> object:
    return ros_bags.raw(ros_bags.START, "front", np.zeros((4, 6, depth), np.uint8), encoding)


def packed_bags() -> list[bytes]:
    """A bag that is compressed as a whole."""
    return [zstandard.ZstdCompressor().compress(bag) for bag in foxglove_bags()]


def databases() -> list[bytes]:
    """A bag in SQLite."""
    return [file(lambda path: ros_bags.write_db3(path, ros_bags.two_cameras(2)[1:5:2]), "b.db3")]


def bags_of_ros_1() -> list[bytes]:
    """Bags of ROS 1: plain and packed ones, and one without its index."""
    rows = ros_bags.two_cameras(2)
    packed = ("none", "bz2", "lz4")
    whole = [file(lambda path, c=c: ros1_bags.write_bag(path, rows, compression=c), "b.bag") for c in packed]
    return [*whole, file(lambda path: ros1_bags.without_index(path, rows), "b.bag")]


def streams() -> list[bytes]:
    """Messages of H.264 and H.265 with their lengths."""
    found = ((b"4", stream_samples.H264), (b"5", stream_samples.H265), (b"4", stream_samples.H264B))
    return [head + b"".join(bytes([len(data)]) + data for data in each if len(data) < 256) for head, each in found]


def tables() -> list[bytes]:
    """One table of each kind."""
    return [
        file(lambda path, kind=kind: write_table(path, random_table(kind, 8), MADE), "t.parquet")
        for kind in TABLES.values()
    ]


def _foreign() -> pa.Table:
    t = 1_700_000_000 + np.arange(8) / 10
    return pa.table({"time": t, "track_id": np.arange(8) % 2, "x_m": t % 7, "y_m": t % 5, "note": list("abcdefgh")})


def foreign_tables() -> list[bytes]:
    """Tables of other programs: Parquet, Arrow's file and stream, Feather."""
    table, out = _foreign(), []
    when = table.set_column(0, "time", pa.array(np.arange(8) * 10**6, pa.timestamp("us", "UTC")))
    for one in (table, when):
        for compression in ("none", "snappy"):
            target = io.BytesIO()
            pq.write_table(one, target, compression=compression)
            out.append(target.getvalue())
        for opened in (pa.ipc.new_file, pa.ipc.new_stream):
            target = io.BytesIO()
            with opened(target, one.schema) as writer:
                writer.write_table(one)
            out.append(target.getvalue())
    target = io.BytesIO()
    feather.write_feather(table, target, compression="lz4")
    return [*out, target.getvalue()]


BOXES = (
    "frame,camera,id,left,top,width,height,confidence,class\n0,a,1,1,2,3,4,0.5,person\n0,b,1,5,6,7,8,0.7,person\n"
    "1,a,1,2,3,4,5,0.9,person\n"
)
MARKED = (
    "camera,u,v,x,y\nleft,640,678,2,2\nleft,336,461,2,5\nleft,999,420,6,2\nleft,709,337,6,5\nleft,688,441,4,3.5\n"
    "right,281,420,2,2\nright,571,337,2,5\nright,640,678,6,2\nright,944,461,6,5\n"
)
MOT = "1,1,10,20,12,30,0.9,-1,-1,-1\n2,1,11,20,12,30,0.8,-1,-1,-1\n2,2,1.5,2,3,4,1,-1,-1,-1\n"
KITTI = (
    "0 1 Pedestrian 0 0 -1.5 10 20 30 60 1.7 0.5 0.6 1 2 3 0.1 0.9\n1 -1 DontCare -1 -1 -10 5 5 9 9 -1 -1 -1 -1 -1 -1 "
    "-1 0.5\n"
)
VATIC = '0 10 20 30 60 0 0 0 0 "Person"\n0 11 20 31 60 1 0 1 0 "Person"\n1 5 5 9 9 1 1 0 0 "Car"\n'
CVAT = (
    '<?xml version="1.0"?><annotations><meta><start_frame>0</start_frame><stop_frame>2</stop_frame></meta>'
    '<track id="1" label="person"><box frame="1" outside="0" xtl="1" ytl="2" xbr="5" ybr="9"/></track></annotations>',
    '<?xml version="1.0"?><annotations><image id="0" width="64" height="48">'
    '<box label="person" xtl="1" ytl="2" xbr="5" ybr="9"/></image></annotations>',
)
SEQUENCE = "[Sequence]\nname=HALL-01\nframeRate=10\nseqLength=50\nimWidth=64\nimHeight=48\n"
POSITIONS = "frame,x,y,score\n0,1.5,2,0.9\n1,2,2.5,0.8\n"
COCO = json.dumps(
    [{"image_id": n, "category_id": 1, "bbox": [1.5, 2, 3, 4], "score": 0.5, "track_id": n} for n in range(3)]
)
GIVEN = json.dumps(
    {
        "images": [{"id": 7, "file_name": "a/000003.jpg", "width": 64, "height": 48}],
        "categories": [{"id": 1, "name": "person"}],
        "annotations": [{"id": 1, "image_id": 7, "category_id": 1, "bbox": [1, 2, 3, 4], "track_id": 5}],
    }
)
DETECTIONS = json.dumps(
    [
        {
            "frame": 0,
            "name": "person",
            "class": 0,
            "confidence": 0.9,
            "box": {"x1": 1, "y1": 2, "x2": 3, "y2": 4},
            "track_id": 1,
        }
    ]
)
WILDTRACK = json.dumps(
    [
        {
            "personID": 122,
            "positionID": 456826,
            "views": [
                {"viewNum": 0, "xmin": 1510, "ymin": 139, "xmax": 1561, "ymax": 288},
                {"viewNum": 1, "xmin": -1, "ymin": -1, "xmax": -1, "ymax": -1},
            ],
        }
    ]
)
YOLO = "0 0.51 0.43 0.08 0.31 0.92 7\n0 0.25 0.5 0.5 1 0.5 8\n"
XML = """<?xml version="1.0" encoding="utf-8"?>
<dataset><frame number="1"><objectlist><object id="9"><box h="80" w="30" xc="100" yc="200"/></object>
</objectlist></frame><frame number="2"><objectlist/></frame></dataset>
"""
TRC = (
    "PathFileType\t4\t(X/Y/Z)\ta.trc\nDataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\t"
    "OrigDataStartFrame\tOrigNumFrames\n10\t10\t2\t2\tm\t10\t1\t2\nFrame#\tTime\ttarget_0\t\t\ttarget_1\t\t\n"
    "\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n\n1\t0.0\t1\t2\t0\t3\t4\t0\n2\t0.1\t1.1\t2\t0\t\t\t\n"
)
TUM = "# a note\n1700000000.1 1 2 0 0 0 0 1\n1700000000.2 1.1 2 0 0 0 0 1\n"
GPX = (
    '<?xml version="1.0"?>\n<gpx version="1.1" xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>'
    '<trkpt lat="52.5163" lon="13.3777"><ele>34</ele><time>2024-05-01T12:00:00Z</time></trkpt>\n'
    '<trkpt lat="52.5164" lon="13.3778"><ele>35</ele><time>2024-05-01T12:00:01Z</time></trkpt></trkseg></trk></gpx>\n'
)
GPS = "time,id,lat,lon,alt\n0,1,52.5163,13.3777,30\n1,1,52.5164,13.3778,31.5\n"
KITTI_POSES = "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0.1 0 1 0 0 0 0 1 1.5e+00\n"
GEOJSON = json.dumps(
    {
        "type": "FeatureCollection",
        "origin": {"latitude": 48.1, "longitude": 11.5, "turned_deg": 10},
        "features": [
            {
                "type": "Feature",
                "properties": {"target_id": 3, "t_ns": [0, 10**9]},
                "geometry": {"type": "LineString", "coordinates": [[11.5, 48.1], [11.5001, 48.1001]]},
            }
        ],
    }
)
TRUTH = "time,id,x,y,z,role\n1.5,2,3,4,0,occluder\n1.5,1,5,6,1.7,target\n0.5,1,7,8,0,target\n"
BOARD = "sync_index,point_id,x_coord,y_coord,z_coord,frame_time\n" + "".join(
    f"{n},{k},{k}.5,{n},0.1,{n}.0\n" for n in range(3) for k in range(4)
)
SYNC = "cam_id,frame_time,sync_index\n0,1.0,0\n1,1.01,0\n0,2.0,1\n1,2.01,1\n"
TIMES = (
    "time\n0.0\n0.1\n0.25\n",
    "frame,camera,t_ns\n0,a,1700000000000000000\n0,b,1700000000000000001\n1,a,1700000000100000000\n",
    "0.0\n0.1\n0.2\n",
    "time\n2024-01-01T00:00:00Z\n2024-01-01T00:00:00.1Z\n",
    "2024-01-01 00:00:00,000\n2024-01-01 00:00:00,100\n",
    "time [ms]\n0\n100\n",
)
LOCATA_HEAD = "year month day hour minute second x y z ref_vec_x ref_vec_y ref_vec_z " + " ".join(
    f"rotation_{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3)
)
LOCATA_ROW = "2018 1 31 23 59 1.5 2 3 1.1 0 1 0 1 0 0 0 1 0 0 0 1"
MICROPHONES = " ".join(f"mic{n}_{axis}" for n in (1, 2) for axis in "xyz")
LOCATA = f"{LOCATA_HEAD} {MICROPHONES}\n{LOCATA_ROW} 2.1 3 1.1 1.9 3 1.1\n".replace(" ", "\t")
LOCATA_SOURCE = f"{LOCATA_HEAD}\n{LOCATA_ROW}\n{LOCATA_ROW.replace('1.5', '2.5')}\n".replace(" ", "\t")
ODAS = "".join(
    f'{{\n    "timeStamp": {n},\n    "src": [\n        {{ "id": 7, "tag": "dynamic", "x": 0.600, "y": 0.800, "z": 0.0,'
    ' "activity": 0.500 },\n        { "id": 0, "tag": "", "x": 0.0, "y": 0.0, "z": 0.0, "activity": 0.0 }\n    ]\n}\n'
    for n in (1, 2, 9)
)
DOA = (
    "time,sensor,azimuth_deg,elevation_deg,sigma_deg,confidence,id\n0,wall,90,30,2,0.5,7\n0,ceiling,-170,,,,-1\n"
    "0.5,wall,91,30,2,0.5,7\n"
)
FRIDA = "recording,algorithm,n_speakers,snr_db,speakers,estimate_deg\nr1,MUSIC,1,10,a,30\nr2,MUSIC,1,10,a,40\n"
TELEMETR = "04/25/91,12:08:15,7,1,wall,81,ceiling,57\n04/25/91,12:09:15,x,1,wall,82,ceiling,0\n"
READERS = "reader,x,y,z,range,power\nA,1,2,2.3,4,-59\nB,3,4,,,\n"
TRACKS = "time,track_id,x_m,y_m\n0,1,2,3\n0.1,1,2.1,3.1\n0.1,2,5,5\n"
READS = "t,reader,tag,rssi\n2,A,x,-70\n1,B,7,-80\n3,A,x,\n"
ELLIPSES = "sensor,target_id,x_px,y_px,a_px,b_px,rho_deg,frame\nview1,0,10,20,5,4,90,3\nview1,1,30,40,6,6,0,0\n"
MATCHES = "sensor_a,sensor_b,xa_px,ya_px,xb_px,yb_px\na,b,1,2,3,4\nb,a,5,6,7,8\n"
STATIONS = ("Tower,x,y\nnorth,0,40\neast,45,-5\n", "name;x_cm;y_cm;z_cm;sigma_deg\na;1;2;3;0.5\nb;4;5;6;2\n")
TOPICS = ("cam1: /cam_front/image_raw\ncam2: [/cam_back/image_raw, /cam_back/camera_info]\n",)
NETWORK = """occlog_network: 1
server: s
links: [[s, r1], [r1, r2]]
objects: {r1: 2, r2: 0}
sensors: [{name: n1, router: r1, detects: 2, assigned: 1}]
cameras: [{name: c1, router: r2}]
"""
MOTION = json.dumps(
    {
        "occlog_motion": 1,
        "length_unit": "m",
        "step_s": 0.1,
        "A": np.eye(4).tolist(),
        "sigma": np.eye(4).tolist(),
        "noise": 0.1,
        "A_error": [[0.1, None, 0.1, 0.1]] * 4,
    }
)
EPIPOLAR = json.dumps(
    {
        "occlog_epipolar": 1,
        "pairs": [{"a": "cam1", "b": "cam2", "matrix": [[0, 1e-5, -3e-3], [-1e-5, 0, 0.02], [3e-3, -0.02, 0]]}],
    }
)
METRICS = json.dumps({"rmse_m": 0.5, "per_target": {"1": {"rmse_m": None}}, "names": ["a", "b"]})
PATH_LOSS = json.dumps(
    {
        "occlog_path_loss": 1,
        "length_unit": "m",
        "height": 1.2,
        "exponent": 1.7,
        "noise_db": 4.5,
        "shadow_db": 3.1,
        "shadow_s": 5.0,
        "window_s": 1.0,
        "readers": [{"name": "A", "power": -59.0, "error": 0.2, "reads": 100}],
        "coverage": {"range": 5.5, "detection": 0.75, "stray": 0.2},
    }
)
METADATA = (
    "rosbag2_bagfile_information:\n  version: 8\n  storage_identifier: mcap\n  relative_file_paths:\n    - b.mcap\n"
    "  topics_with_message_count:\n    - topic_metadata: {name: /p, type: x}\n      message_count: 1\n"
    '  compression_mode: ""\n'
)
HOMOGRAPHY = "509.28 -84.689 327.83\n57.564 57.564 1429.75\n0.664463 0.664463 1.02606\n"
MARKED_POINTS = "camera,u,v,x,y\ncam1,211,634,0,0\ncam1,987,641,4,0\ncam1,803,402,4,6\ncam1,396,398,0,6\n"
PROJECTION = "500 0 320 100\n0 505 238.5 20\n0 0 1 4\n"
TOML = (
    '[cam_0]\nname = "cam_0"\nsize = [640, 480]\nmatrix = [[500.0, 0.0, 320.0], [0.0, 505.0, 238.5], [0.0, 0.0, 1.0]]\n'
    "distortions = [-0.2, 0.05, 0.001, -0.002, 0.0]\nrotation = [0.1, 0.2, 0.3]\ntranslation = [1.0, 2.0, 3.0]\n"
    "[metadata]\nerror = 0.1\n"
)
TSAI = """<?xml version="1.0" encoding="utf-8"?>
<Camera name="View_001"><Geometry width="768" height="576" ncx="795" nfx="752" dx="0.0048" dy="0.0046" dpx="0.0051" \
dpy="0.0046"/><Intrinsic focal="5.55" kappa1="0.0051" cx="324.2" cy="282.6" sx="1.09"/><Extrinsic tx="-34.4" \
ty="4.5" tz="79.2" rx="1.9" ry="0.43" rz="-0.04"/></Camera>
"""
KALIBR = """cam0:
  camera_model: pinhole
  distortion_coeffs: [-0.2, 0.05, 0.001, -0.002]
  distortion_model: radtan
  intrinsics: [500.0, 505.0, 320.0, 238.5]
  resolution: [640, 480]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.1]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: [-0.02, 0.03, -0.02, 0.004]
  distortion_model: equidistant
  intrinsics: [500.0, 505.0, 320.0, 238.5]
  resolution: [640, 480]
"""
ROS = """header: {frame_id: cam0_optical_frame}
height: 480
width: 640
distortion_model: plumb_bob
d: [-0.2, 0.05, 0.001, -0.002, 0.0]
k: [500.0, 0.0, 320.0, 0.0, 505.0, 238.5, 0.0, 0.0, 1.0]
---
transforms:
- header: {frame_id: map}
  child_frame_id: cam0_optical_frame
  transform:
    translation: {x: 1.0, y: 2.0, z: 3.0}
    rotation: {x: -0.5, y: 0.5, z: -0.5, w: 0.5}
---
"""
COLMAP_CAMERAS = "# Camera list\n1 OPENCV 640 480 500 505 320.5 239 -0.2 0.05 0.001 -0.002\n"
COLMAP_IMAGES = (
    "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n1 1 0 0 0 0.5 0 2 1 cam0/000001.jpg\n1.5 2.5 -1\n"
)
_K = np.array([[500.0, 0, 320], [0, 505, 238.5], [0, 0, 1]])
_RT = np.column_stack([np.diag([1.0, -1.0, -1.0]), [0.1, 0.2, 4.0]])


def storage(ending: str, *, lens: bool = True, place: bool = True) -> bytes:
    """A calibration as OpenCV writes it."""
    store = cv2.FileStorage(ending, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    if lens:
        store.write("camera_matrix", _K)
        store.write("dist_coeffs", np.array([-0.2, 0.05, 0.001, -0.002, 0.0]))
        store.write("image_width", 640)
        store.write("image_height", 480)
    if place:
        store.write("rvec", np.array([[3.0], [0.1], [0.2]]))
        store.write("tvec", np.array([[0.1], [0.2], [4.0]]))
    return str(store.releaseAndGetString()).encode()


def arrays(ending: str) -> Callable[[], list[bytes]]:
    """Matrices of two cameras, in three forms."""
    forms = [
        {"P": np.array([_K @ _RT, _K @ _RT * 1.5])},
        {"K": _K, "R": _RT[:, :3], "t": _RT[:, 3], "dist": np.array([-0.2, 0.05, 0.001, -0.002, 0])},
        {"left": _K @ _RT, "right": _K @ _RT * 1.5},
    ]

    def make() -> list[bytes]:
        if ending == "npy":
            return [file(lambda path: np.save(path, forms[0]["P"]), "a.npy")]
        if ending == "npz":
            return [file(lambda path, form=form: np.savez(path, **form), "a.npz") for form in forms]
        packed = [file(lambda path: savemat(path, forms[0], do_compression=True), "a.mat")]
        return [*(file(lambda path, form=form: savemat(path, form), "a.mat") for form in forms), *packed]

    return make


def networks() -> list[bytes]:
    """A network of ONNX."""
    values = {"output0": np.zeros((1, 5, 8), np.float32)}
    named = {"names": "{0: 'owl'}"}
    return [file(lambda path: constant_network(path, values, image=("n", 3, 64, "w"), metadata=named), "a.onnx")]


def sounds() -> list[bytes]:
    """WAV of each kind of samples."""
    out = []
    for tag, bits in ((1, 8), (1, 16), (1, 24), (1, 32), (3, 32), (3, 64)):
        frame = 2 * bits // 8
        head = struct.pack("<HHIIHH", tag, 2, 8000, 8000 * frame, frame, bits)
        body = b"WAVEfmt " + struct.pack("<I", 16) + head + b"data" + struct.pack("<I", 5 * frame) + bytes(5 * frame)
        out.append(b"RIFF" + struct.pack("<I", len(body)) + body)
    return out


def images(ending: str) -> Callable[[], list[bytes]]:
    """Images in colour and in grey."""
    x = np.random.default_rng(0).integers(0, 256, (12, 16, 3)).astype(np.uint8)
    return lambda: [cv2.imencode(ending, image)[1].tobytes() for image in (x, x[..., 0])]


def videos_avi() -> list[bytes]:
    """AVI: motion JPEG with a dropped frame, and FFV1."""
    return [avi([jpeg(0, (16, 16)), b"", jpeg(1, (16, 16))]), file(lambda p: write_video(p, 3), "ffv1.avi")]


def videos_mp4() -> list[bytes]:
    """MP4: as written, for streaming, and in fragments."""
    whole = file(lambda path: write_video(path, 4), "mp4v.mp4")
    return [whole, faststart(whole), fragmented(file(lambda path: write_video(path, 4), "mp4v.mp4"), 2)]


def videos_mkv() -> list[bytes]:
    """Matroska."""
    return [file(lambda path: write_video(path, 4), name) for name in ("mjpg.mkv", "ffv1.mkv")]


def packed(*parts: str) -> Callable[[], list[bytes]]:
    """Texts that gzip has compressed."""
    return lambda: [gzip.compress(part.encode(), mtime=0) for part in parts]


def packets() -> list[bytes]:
    """The parameters of H.264 of an image of 640 x 480 px, and the head of a key frame of VP8."""
    h264 = bytes.fromhex("000000016742c01ed900a03da1000003000100000300280f162e4800000001")
    return [h264, b"\x10\x02\x00\x9d\x01\x2a\x40\x00\x30\x00" + bytes(20)]
