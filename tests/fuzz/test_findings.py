"""What fuzzing has found, each as short as it could be made: once a traceback or worse, now one line."""

from __future__ import annotations

import io
import json
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from mcap.writer import Writer
from places import EXAMPLES
from scipy.io import wavfile

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.formats.calibration.readers import colmap
from occlog.io.formats.models.fundamental_matrices import read_epipolar
from occlog.io.formats.models.motion_models import read_motion
from occlog.io.formats.truth import read_sync_times
from occlog.io.frames.codec import image_size
from occlog.records.declared.tracks import Cooperation
from occlog.records.declared.world import Occluders

from . import seeds
from .readers import READERS
from .watch import Watch, watching

LARGE = "1" + "0" * 300
WRAPPED = [
    ("truth", f"time,id,x,y\n0,{2**32 + 5},1,2\n"),
    ("directions (CSV)", f"time,sensor,azimuth_deg,id\n0,wall,90,{2**32 + 5}\n"),
    ("foreign table (text)", f"time,track_id,x_m,y_m\n0,{2**32 + 5},2,3\n"),
    ("trajectories (GeoJSON)", seeds.GEOJSON.replace('d": 3', f'd": {2**32 + 5}')),
]
"""Identities of 33 bits: tables hold 32 of them, and the 33rd was cut off, which made 5 of them."""


def with_zone(name: bytes) -> bytes:
    """A table of Arrow whose times are of a zone of that name, of two bytes."""
    at = pa.array([1_700_000_000_000_000_000], pa.timestamp("ns", tz="XY"))
    table = pa.table({"time": at, "track_id": [1], "x_m": [1.0], "y_m": [2.0]})
    out = io.BytesIO()
    with pa.ipc.new_file(out, table.schema) as writer:
        writer.write_table(table)
    return out.getvalue().replace(b"XY\0", name + b"\0")


def with_name(name: bytes) -> bytes:
    """A table of Arrow with a column of that name, of two bytes."""
    table = pa.table({"XY": pa.array([1], pa.timestamp("ns")), "track_id": [1], "x_m": [1.0], "y_m": [2.0]})
    out = io.BytesIO()
    with pa.ipc.new_file(out, table.schema) as writer:
        writer.write_table(table)
    return out.getvalue().replace(b"XY\0", name + b"\0")


FINDINGS = [
    (
        "boxes (CVAT)",
        seeds.CVAT[1].replace('id="0"', f'id="{"9" * 4400}"').encode(),
        "b.xml: image 999",
    ),
    ("boxes (CVAT)", seeds.CVAT[1].replace('id="0"', 'id="²"').encode(), "frame"),
    ("boxes (CVAT)", seeds.CVAT[1].replace('id="0"', 'id="1000000000"').encode(), "b.xml: image 1000000000: "),
    ("positions", b"frame,x,y\n9007199254740993,1,2\n", "p.csv: frame 9007199254740993: its time"),
    ("foreign table (Arrow)", with_name(b"\xd3C"), "damaged or not an Arrow file"),
    ("trajectories (TRC)", seeds.TRC.encode() + b"\xed", "0xed that is not UTF-8"),
    ("trajectories (TRC)", seeds.TRC.encode() + b"2\t0.2\t" + b"1" * 201 + b"\t2\t0\n", "a cell of more than 200 char"),
    ("trajectories (TRC)", seeds.TRC.encode() + b" " * 1_000_001, "longer than 1000000 characters"),
    ("boxes (KITTI)", seeds.KITTI.encode() + b" " * 1_000_001, "longer than 1000000 characters"),
    ("trajectories (GeoJSON)", seeds.GEOJSON.replace("48.1001", "9" * 400).encode(), "no list of [longitude"),
    (
        "trajectories (GeoJSON)",
        seeds.GEOJSON.replace("48.1,", "9" * 400 + ",").encode(),
        "--origin LAT,LON",
    ),
    ("trajectories (GeoJSON)", seeds.GEOJSON.replace('d": 3', f'd": {"9" * 400}').encode(), "t.geojson: "),
    ("trajectories (GeoJSON)", seeds.GEOJSON.replace("1000000000", "9" * 400).encode(), "t.geojson: "),
    ("boxes (YOLO)", (seeds.YOLO + "0 0.25 0.5 0.5 1 0.5 \n").replace(" 8\n", " 1e19\n").encode(), "a whole number"),
    ("boxes (YOLO)", (seeds.YOLO + "0 0.25 0.5 0.5 1 0.5\n").replace(" 8\n", " 7.5\n").encode(), "id is '7.5'"),
    ("directions (ODAS)", seeds.ODAS.replace("0.600", "9" * 400, 1).encode(), "x of a source is"),
    ("directions (ODAS)", seeds.ODAS.replace("0.600", "1" + "0" * 40, 1).encode(), "a unit vector was expected"),
    ("truth (board)", b"sync_index,point_id,x_coord,y_coord,z_coord\n", "holds a header and no row"),
    ("arrays", b"1 2\n" * 10_001, "a.csv: 10001 rows; positions of at most 10000 direction finders"),
    ("arrays", b"x,y,z\n", "holds a header and no row"),
    (
        "calibration (storage, XML)",
        seeds.storage(".xml").replace(b"<rows>3</rows>", b"<rows>" + b"9" * 4400 + b"</rows>"),
        "expected a 3 x 3 camera matrix",
    ),
    ("tag readers", b"reader,x,y\n ,0,40\n", "r.csv: line 2: reader is empty"),
    ("calibration (TOML)", seeds.TOML.replace('name = "cam_0"', 'name = " "').encode(), "a camera has no name"),
    ("calibration (COLMAP, images)", b"1 1 0 0 0 0 0 2 1 a.jpg\n\n" * 2_001, "2001 images; each becomes a camera"),
    ("stations", b"Tower,x,y\n,0,40\n", "s.csv: line 2: the station has no name"),
    ("foreign table (text)", b"time,conf,score,bbox\n0,1,1,1\n", "t.csv: "),
    (
        "boxes (WILDTRACK)",
        seeds.WILDTRACK.replace("122", "1e999").encode(),
        "person 1: personID is inf; a whole number",
    ),
    ("truth (WILDTRACK)", seeds.WILDTRACK.replace("122", "9" * 30).encode(), "person 1: personID is 999"),
    ("truth (WILDTRACK)", seeds.WILDTRACK.replace('Num": 0', 'Num": 0.5').encode(), "person 1: viewNum is 0.5"),
    (
        "time stamps",
        b"time\n2024-01-01T00:00:00Z\n9024-01-01T00:00:00Z\n",
        "t.csv: line 3: time '9024-01-01T00:00:00Z'",
    ),
    ("bag (metadata)", seeds.METADATA.replace("- b.mcap", "- c.mcap").encode(), "bag/c.mcap: no such file"),
    ("bag (metadata)", seeds.METADATA.replace("- b.mcap", f"- {'c' * 300}.mcap").encode(), "File name too long"),
    ("bag (metadata)", seeds.METADATA.replace("- b.mcap", '- "c\\0.mcap"').encode(), "no name of a file"),
    ("calibration (projection)", seeds.PROJECTION.replace("500", LARGE).encode(), "cannot be inverted"),
    ("boxes (KITTI)", seeds.KITTI.replace("20", f"{2**63}751e308").encode(), "a finite number was expected"),
    (
        "boxes (JSON)",
        seeds.COCO[:-1].encode() + b", 5]",
        "entry 4: '5'; an object with a box was expected",
    ),
    ("boxes (JSON)", seeds.GIVEN.replace('"image_id": 7', '"image_id": [7]').encode(), "annotation 1: its image_id is"),
    ("boxes (JSON)", seeds.GIVEN.replace('"image_id": 7', '"image_id": 7, "image_id": 8').encode(), "appears twice"),
    ("boxes (JSON)", seeds.GIVEN.replace('"categories": [', '"categories": [7, ').encode(), "category 1: has no id"),
    (
        "boxes (JSON)",
        seeds.GIVEN.replace('"categories": [', '"categories": [{"id": 1, "name": "car"}, ').encode(),
        "category 2: has the id of 'car'",
    ),
    (
        "boxes (JSON)",
        seeds.GIVEN.replace("000003", "1" + "0" * 40).encode(),
        "image 1: frame 100000000000000000000000; it must be",
    ),
    (
        "truth",
        b"frame,camera,time,left,top,width,height,confidence\n0,a,1,1,2,3,4,1\n0,b,1,5,6,7,8,0\n1,a,2,2,3,4,5,1\n",
        "g.csv: camera b: no frame has a time",
    ),
    (
        "truth",
        b"frame,camera,time,left,top,width,height\n0,a,1,1,2,3,4\n1,a,2147483648,2,3,4,5\n9,b,3,2,3,4,5\n",
        "times that are out of range",
    ),
    (
        "directions (CSV)",
        b"time,sensor,azimuth_deg,id\n0,wall,90,-7\n",
        "d.csv: line 2: id is -7; it must be -1 to 2147483647",
    ),
    *((name, row.encode(), f"is {2**32 + 5}; it must be") for name, row in WRAPPED),
    ("boxes (YOLO)", b"0 0.5 0.5 inf 0.3 0.9 7\n", "000002.txt: line 1: width (share) is 'inf'"),
    ("directions (CSV)", b"time,sensor,azimuth_deg,confidences\n0,wall,90,1\n", "; did you mean 'confidence'?"),
    ("foreign table (Arrow)", with_zone(b"\xd4C"), "column time: "),
    ("calibration (Kalibr)", seeds.KALIBR.replace("-0.1]", "-1.0e+308]").encode(), "limit 1e+12"),
    ("truth", b"time,id,x,y\n0,1,10000000000000000,2\n", "g.csv: Truth.x: row 0: 1e+16 m must be within 1e+15 m"),
    ("directions (FRIDA)", b"algorithm,estimate_deg\nMUSIC,110\n", "d.csv: has no column recording"),
    (
        "scene",
        b"occlog_scene: 1\nroom: [[0, 0], [12, 0], [1.0e+308, 1.0e+308], [-1.0e+308, 8]]\n",
        "line 2: room[2][0]: expected `float` <= 1000000000000.0",
    ),
    (
        "scene",
        b"occlog_scene: 1\ncameras: [{name: a, focal_px: 1.0e-320, image_size_px: [9, 9]}]\n",
        "focal_px: expected `float` >= 0.001",
    ),
    (
        "calibration (COLMAP, images)",
        seeds.COLMAP_IMAGES.replace("1 1 0", f"1 {LARGE} 0").encode(),
        "no unit quaternion",
    ),
]


def late_fragment() -> bytes:
    """MP4 with a fragment at a time of 2^63 ticks."""
    data = bytearray(seeds.videos_mp4()[2])
    time = data.index(b"tfdt") + 8
    assert data[time - 4] == 1, "its time has 64 bits"
    data[time : time + 8] = b"\xff" * 8
    return bytes(data)


def signalling_sound() -> bytes:
    """A sound of floats of which one is a NaN that signals."""
    out = io.BytesIO()
    wavfile.write(out, 8000, np.zeros((64, 2), np.float32))
    data = bytearray(out.getvalue())
    data[-4:] = b"\x01\0\x80\x7f"
    return bytes(data)


@pytest.fixture(scope="module")
def watch() -> Iterator[Watch]:
    with watching() as found:
        yield found


@pytest.mark.parametrize(("name", "data", "words"), FINDINGS, ids=[name for name, *_ in FINDINGS])
def test_a_finding_is_refused_in_one_line(name: str, data: bytes, words: str, watch: Watch) -> None:
    outcome = watch.outcome(READERS[name], data)
    assert outcome.kind == "refused", outcome
    assert words in outcome.detail


def test_a_signalling_nan_is_one_that_says_nothing() -> None:
    """Sums with it warn: a place, or its covariance, is not there."""
    signals = np.array([0x7FF0000000000001], dtype=np.uint64).view(np.float64)
    columns = dict.fromkeys(("x", "y", "cov_xx", "cov_xy", "cov_yy"), signals)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        asked = {"cause": ["count"], "cameras": ["a"], "frames": [1], "answered": [False]}
        assert np.isnan(Cooperation.of(t_ns=[1], target_id=[0], **asked, **columns).x[0])
        assert np.isnan(Occluders.of(t_ns=[1], occluder_id=[-1], **columns).x[0])


def test_a_box_may_end_behind_the_file(watch: Watch) -> None:
    """Boxes were looked for in it beyond the file's last byte."""
    data = bytearray(seeds.videos_mp4()[2])
    size = data.rindex(b"traf") - 4
    data[size : size + 4] = (len(data) + 1000).to_bytes(4, "big")
    assert watch.outcome(READERS["video (MP4)"], bytes(data)).kind == "read"


def nested_message() -> bytes:
    """A bag of which a message is JSON in brackets as deep as no one reads."""
    out = io.BytesIO()
    writer = Writer(out)
    writer.start()
    schema = writer.register_schema("foxglove.CompressedImage", "jsonschema", b"{}")
    channel = writer.register_channel("/image", "json", schema)
    for n in range(3):
        writer.add_message(channel, n, b"[" * 100_000, n)
    writer.finish()
    return out.getvalue()


def endless_bag() -> bytes:
    """The metadata of a bag with more messages than a number says."""
    return seeds.METADATA.replace("message_count: 1", "message_count: .inf").encode()


@pytest.mark.parametrize(
    ("name", "make"),
    [
        ("video (MP4)", late_fragment),
        ("sound", signalling_sound),
        ("bag (metadata)", endless_bag),
        ("bag (Foxglove)", nested_message),
    ],
)
def test_a_finding_is_read(name: str, make: Callable[[], bytes], watch: Watch) -> None:
    assert watch.outcome(READERS[name], make()).kind == "read"


def test_as_many_arrays_as_may_be(watch: Watch) -> None:
    assert watch.outcome(READERS["arrays"], b"1 2\n" * 10_000).kind == "read"


def test_as_many_images_of_a_model_as_may_be(watch: Watch, monkeypatch: pytest.MonkeyPatch) -> None:
    """They come to the check of poses, which is behind that of their number."""
    monkeypatch.setattr(colmap, "MAX_IMAGES", 3)
    images = b"1 1 0 0 0 0 0 2 1 a.jpg\n\n" * 2 + b"1 1 0 0 0 5 0 2 1 a.jpg\n\n"
    found = watch.outcome(READERS["calibration (COLMAP, images)"], images)
    assert "two images of camera 'a'" in found.detail


def test_many_times_of_one_moment_take_no_time_in_proportion_to_their_square(tmp_path: Path) -> None:
    """They are exact, too: sums of times do not fit into floating-point numbers.  Pair by pair it took minutes."""
    start = 1_700_000_000_000_000_000
    path = tmp_path / "t.csv"
    path.write_text("sync_index,frame_time_ns\n" + "".join(f"7,{start + k}\n" for k in range(40_001)))
    assert read_sync_times(path) == {7: start + 20_000}


def test_the_size_of_a_jpeg_is_found_behind_bytes_that_mean_nothing() -> None:
    """Decoders pass over them: an image of 485 million pixels was not seen to be one."""
    data = cv2.imencode(".jpg", np.zeros((48, 64, 3), np.uint8))[1].tobytes()
    assert image_size(data) == (64, 48)
    for garbage in (b"\0\x01WXYZ", b"\xff", b"\xff\0\xff\xd0"):
        assert image_size(data[:20] + garbage + data[20:]) == (64, 48)
        decoded = cv2.imdecode(np.frombuffer(data[:20] + garbage + data[20:], np.uint8), cv2.IMREAD_COLOR)
        assert decoded is None or decoded.shape == (48, 64, 3)


def test_large_fundamental_matrices_stay_what_they_are(tmp_path: Path) -> None:
    """The sum of the squares of their entries was infinite."""
    pair = json.loads(seeds.EPIPOLAR)["pairs"][0]
    matrices = []
    for factor in (1.0, 2.0**1020):
        path = tmp_path / "e.json"
        large = [[factor * entry for entry in row] for row in pair["matrix"]]
        path.write_text(json.dumps({"occlog_epipolar": 1, "pairs": [{**pair, "matrix": large}]}))
        matrices.append(read_epipolar(path).pairs[0].matrix)
    assert np.array_equal(*matrices)


def test_large_covariances_stay_what_they_are(tmp_path: Path) -> None:
    """Half of their sum was infinite."""
    path = tmp_path / "m.json"
    path.write_text(json.dumps({**json.loads(seeds.MOTION), "sigma": (1.2e308 * np.eye(4)).tolist()}))
    assert np.array_equal(read_motion(path).sigma, 1.2e308 * np.eye(4))


def test_names_of_thousands_of_characters_fill_no_screen(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "s.yaml"
    path.write_text(f"occlog_sweep: 1\nscene: {'s' * 3000}\n")
    assert run(["sweep", str(path), "-o", str(tmp_path / "out")]) == ExitCode.BAD_INPUT
    assert len(capfd.readouterr().err) <= 430


def test_a_table_without_times_is_described(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = pq.read_table(io.BytesIO(seeds.tables()[0]))
    pq.write_table(table.set_column(0, "t_ns", pa.nulls(len(table), pa.int64())), tmp_path / "t.parquet")
    assert run(["info", str(tmp_path / "t.parquet")]) == ExitCode.DONE
    assert "time  " not in capsys.readouterr().out


def test_names_in_files_move_no_cursor(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "s.yaml"
    path.write_text('occlog_scene: 1\n"\\e[2Jname": 1\n')
    assert run(["simulate", str(path), "-o", str(tmp_path / "x.mcap")]) == ExitCode.BAD_INPUT
    (line,) = capfd.readouterr().err.splitlines()
    assert "\\x1b[2Jname" in line
    assert "\x1b" not in line


@pytest.mark.parametrize(
    ("words", "content", "named"),
    [
        (["simulate", "FILE.yaml", "-o", "x.mcap"], "occlog_scene: 1\nlength_unit: " + "m" * 3000, "FILE.yaml: line 2"),
        (
            ["ingest", "-o", "x.mcap", "--calibration", "FILE.txt", "--boxes", "a=FILE.txt"],
            "1,1,1,2,3,4,1,1,1\n",
            "--calibration-format",
        ),
        (["info", "FILE.csv"], f"time,track_id,x_m,{'- ' * 2000}\n0,1,2,3\n", "FILE.csv: tracks requires y"),
        (["ingest", "FILE.mcap", "none.mcap", "-o", "x.mcap"], "no bag", "FILE.mcap: neither"),
        (["ingest", "-o", "x.mcap", "--truth", "FILE.csv", "--fps", "1,2"], "frame,id,x,y\n0,1,2,3\n", "--fps"),
        (
            ["track", "FILE.csv", "--scene", str(EXAMPLES / "room.yaml"), "--method", "fix", "-o", "x.parquet"],
            "time,sensor,bearing_rad,sigma_rad\n0,nowhere,1,0.1\n",
            "FILE.csv: bearings: row 0: no sensor 'nowhere'",
        ),
    ],
)
def test_the_line_of_a_command_is_short_and_names_the_file_once(
    words: list[str],
    content: str,
    named: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """Values of files filled the screen, all formats of calibrations were described, and bags were named twice."""
    monkeypatch.chdir(tmp_path)
    (file,) = {word.rpartition("=")[2] for word in words if "FILE" in word}
    Path(file).write_text(content)
    assert run(words) in (ExitCode.BAD_INPUT, ExitCode.USAGE)
    (line,) = capfd.readouterr().err.splitlines()
    assert named in line
    assert len(line) <= 300
    assert line.count("FILE") <= 1
    assert not Path("x.mcap").exists()
