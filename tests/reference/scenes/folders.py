"""Folders as people have them: the same hall and people in the files of many programs, and unclean variants."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import yaml
from people_boxes import SIZE, STEP_NS, boxes, hall, place, truth
from scipy.io import wavfile
from scipy.spatial.transform import Rotation

from occlog.array_types import Floats
from occlog.cli.main import run
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.io.recording.reader import open_recording
from occlog.records.scene import Camera, Scene
from occlog.records.tables import Boxes, Truth

SECONDS, PEOPLE = 5.0, 3
RATE = round(1e9 / STEP_NS)
START = 1_700_000_000_000_000_000


@cache
def found(names: str = "abc", *, true: bool = False) -> Boxes:
    """Boxes of a detector in the hall, or the true ones."""
    return boxes(hall(names), SECONDS, people=PEOPLE, **({"miss": 0.0, "px": 0.0} if true else {}))


def rows_of(
    camera: str, names: str = "abc", *, true: bool = False
) -> list[tuple[int, int, float, float, float, float]]:
    """Frame, person, left, top, width and height of the boxes of a camera."""
    own = found(names, true=true)
    own = own.take((own.sensor == camera) & (own.box >= 0))
    columns = (own.frame, own.target_id, own.left_px, own.top_px, own.width_px, own.height_px)
    return list(zip(*(column.tolist() for column in columns), strict=True))


def truth_csv(path: Path, *, framed: bool = False, first: int = 0) -> None:
    """True positions by time, or by frame."""
    lines = ["frame,id,x,y" if framed else "time,id,x,y"]
    for frame in range(round(SECONDS * RATE)):
        for person in range(PEOPLE):
            x, y = place(person, frame / RATE)
            at = str(frame + first) if framed else f"{frame / RATE:.1f}"
            lines.append(f"{at},{person},{x:.4f},{y:.4f}")
    path.write_text("\n".join(lines) + "\n")


def opencv(folder: Path, scene: Scene, *, names: dict[str, str] | None = None, scale: float = 1.0) -> None:
    """A file of OpenCV for each camera."""
    folder.mkdir(parents=True, exist_ok=True)
    for camera in scene.cameras:
        out = cv2.FileStorage(
            str(folder / f"{(names or {}).get(camera.name, camera.name)}.yaml"), cv2.FILE_STORAGE_WRITE
        )
        assert camera.image_size is not None
        out.write("image_width", round(camera.image_size[0] * scale))
        out.write("image_height", round(camera.image_size[1] * scale))
        out.write("camera_matrix", intrinsic(camera, scale))
        out.write("distortion_coefficients", np.zeros((1, 5)))
        out.write("R", camera.rotation.T)
        out.write("T", -camera.rotation.T @ camera.position.reshape(3, 1))
        out.release()


def intrinsic(camera: Camera, scale: float = 1.0) -> Floats:
    """(3, 3) camera matrix."""
    (fx, fy), (cx, cy) = camera.focal_px * scale, (camera.principal_px + 0.5) * scale - 0.5
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])


def yolo(folder: Path, camera: str, *, first: int = 1, classes: bool = False) -> None:
    """Labels of a camera as Ultralytics writes them; with classes a chair (56) is in each frame."""
    folder.mkdir(parents=True, exist_ok=True)
    for frame, _, left, top, width, height in rows_of(camera):
        shares = ((left + width / 2) / SIZE[0], (top + height / 2) / SIZE[1], width / SIZE[0], height / SIZE[1])
        with (folder / f"walk_{frame + first}.txt").open("a") as file:
            file.write("0 " + " ".join(f"{v:.6f}" for v in shares) + " 0.9\n")
    if classes:
        for file in folder.glob("*.txt"):
            file.write_text(file.read_text() + "56 0.5 0.6 0.2 0.1 0.6\n")


def kalibr(path: Path, scene: Scene) -> None:
    """The cameras as Kalibr has them: the world is the frame of the first one."""
    chain: dict[str, dict[str, object]] = {}
    before: Floats = np.eye(4)
    for n, camera in enumerate(scene.cameras):
        here = np.eye(4)
        here[:3, :3], here[:3, 3] = camera.rotation.T, -camera.rotation.T @ camera.position
        assert camera.image_size is not None
        chain[f"cam{n}"] = {
            "camera_model": "pinhole",
            "distortion_model": "radtan",
            "distortion_coeffs": [0.0] * 4,
            "intrinsics": [*camera.focal_px.tolist(), *camera.principal_px.tolist()],
            "resolution": list(camera.image_size),
        }
        if n:
            chain[f"cam{n}"]["T_cn_cnm1"] = (here @ np.linalg.inv(before)).tolist()
        before = here
    path.write_text(yaml.safe_dump(chain))


def colmap(folder: Path, scene: Scene) -> None:
    """A text model of COLMAP in the scene's world, an image for each camera."""
    folder.mkdir(parents=True, exist_ok=True)
    cameras, images = ["# cameras"], ["# images"]
    for n, camera in enumerate(scene.cameras, start=1):
        (fx, fy), (cx, cy), size = camera.focal_px, camera.principal_px + 0.5, camera.image_size
        assert size is not None
        cameras.append(f"{n} PINHOLE {size[0]} {size[1]} {fx} {fy} {cx} {cy}")
        turn, shift = camera.rotation.T, -camera.rotation.T @ camera.position
        x, y, z, w = Rotation.from_matrix(turn).as_quat().tolist()
        images += [f"{n} {w} {x} {y} {z} {' '.join(map(repr, shift.tolist()))} {n} {camera.name}.jpg", ""]
    (folder / "cameras.txt").write_text("\n".join(cameras) + "\n")
    (folder / "images.txt").write_text("\n".join(images) + "\n")


def homographies(folder: Path, scene: Scene) -> None:
    """The homography from the image to the ground of each camera, as text."""
    folder.mkdir(parents=True, exist_ok=True)
    for camera in scene.cameras:
        turn = camera.rotation.T
        to_image = intrinsic(camera) @ np.column_stack([turn[:, 0], turn[:, 1], -turn @ camera.position])
        np.savetxt(folder / f"{camera.name}_H.txt", np.linalg.inv(to_image))


def pairs(folder: Path, scene: Scene) -> None:
    """Two files a camera, as in WILDTRACK, in cm, with the world 4 m to the right."""
    for part in ("intrinsic_zero", "extrinsic"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    for n, camera in enumerate(scene.cameras, start=1):
        lens = cv2.FileStorage(str(folder / "intrinsic_zero" / f"intr_CVLab{n}.xml"), cv2.FILE_STORAGE_WRITE)
        lens.write("camera_matrix", intrinsic(camera))
        lens.write("distortion_coefficients", np.zeros((1, 5)))
        lens.release()
        pose = cv2.FileStorage(str(folder / "extrinsic" / f"extr_CVLab{n}.xml"), cv2.FILE_STORAGE_WRITE)
        pose.write("rvec", cv2.Rodrigues(camera.rotation.T)[0])
        pose.write("tvec", -100.0 * camera.rotation.T @ (camera.position - [4, 0, 0]).reshape(3, 1))
        pose.release()


def mot(folder: Path, camera: str, name: str) -> None:
    """A MOTChallenge sequence of a camera."""
    for part in ("det", "gt"):
        (folder / name / part).mkdir(parents=True)
    rows = rows_of(camera)
    lines = [f"{f + 1},-1,{left:.2f},{top:.2f},{w:.2f},{h:.2f},0.9,-1,-1,-1" for f, _, left, top, w, h in rows]
    (folder / name / "det" / "det.txt").write_text("\n".join(lines) + "\n")
    rows = rows_of(camera, true=True)
    lines = [f"{f + 1},{k + 1},{left:.2f},{top:.2f},{w:.2f},{h:.2f},1,1,1" for f, k, left, top, w, h in rows]
    (folder / name / "gt" / "gt.txt").write_text("\n".join(lines) + "\n")
    (folder / name / "seqinfo.ini").write_text(
        f"[Sequence]\nname={name}\nimDir=img1\nframeRate={RATE}\nseqLength={round(SECONDS * RATE)}\n"
        f"imWidth={SIZE[0]}\nimHeight={SIZE[1]}\nimExt=.jpg\n"
    )


def coco(path: Path, camera: str, size: tuple[int, int] = SIZE) -> None:
    """COCO of a camera's images, which may have been scaled."""
    across, down = size[0] / SIZE[0], size[1] / SIZE[1]
    images = [
        {"id": f, "file_name": f"{camera}/{f:06d}.jpg", "width": size[0], "height": size[1]}
        for f in range(round(SECONDS * RATE))
    ]
    rows = enumerate(rows_of(camera))
    annotations = [
        {"id": n, "image_id": f, "category_id": 1, "bbox": [a * across, b * down, w * across, h * down], "score": 0.9}
        for n, (f, _, a, b, w, h) in rows
    ]
    values = {"images": images, "annotations": annotations, "categories": [{"id": 1, "name": "person"}]}
    path.write_text(json.dumps(values))


def cvat(path: Path, camera: str) -> None:
    """XML of CVAT for video: people with identities, and a chair."""
    last = round(SECONDS * RATE) - 1
    tracks = {k: [r for r in rows_of(camera) if r[1] == k] for k in range(PEOPLE)}

    def box(frame: int, left: float, top: float, width: float, height: float) -> str:
        edges = f'xtl="{left:.2f}" ytl="{top:.2f}" xbr="{left + width:.2f}" ybr="{top + height:.2f}"'
        return f'<box frame="{frame}" outside="0" occluded="0" keyframe="1" {edges} z_order="0"></box>'

    body = "".join(
        f'<track id="{k}" label="person">{"".join(box(f, *edges) for f, _, *edges in rows)}</track>'
        for k, rows in tracks.items()
    )
    chair = f'<track id="{PEOPLE}" label="chair">{"".join(box(f, 5, 5, 40, 60) for f in range(last + 1))}</track>'
    meta = f"<meta><job><start_frame>0</start_frame><stop_frame>{last}</stop_frame></job></meta>"
    path.write_text(f'<?xml version="1.0"?>\n<annotations><version>1.1</version>{meta}{body}{chair}</annotations>\n')


def wildtrack(folder: Path, scene: Scene) -> None:
    """Annotations of a frame in a file, with positions on WILDTRACK's grid and boxes in all views."""
    folder.mkdir(parents=True)
    names = [camera.name for camera in scene.cameras]
    own = found("".join(names))
    for frame in range(round(SECONDS * RATE)):
        people = []
        for person in range(PEOPLE):
            x, y = place(person, frame / RATE)
            position = round((x - 4 + 3.0) / 0.025) + 480 * round((y + 9.0) / 0.025)
            views = []
            for view, camera in enumerate(names):
                row = own.take((own.frame == frame) & (own.target_id == person) & (own.sensor == camera))
                edges = [-1] * 4
                if len(row):
                    left, top = row.left_px[0], row.top_px[0]
                    edges = [round(v) for v in (left, top, left + row.width_px[0], top + row.height_px[0])]
                views.append(dict(zip(("viewNum", "xmin", "ymin", "xmax", "ymax"), [view, *edges], strict=True)))
            people.append({"personID": person, "positionID": position, "views": views})
        (folder / f"{frame:08d}.json").write_text(json.dumps(people))


def bag(path: Path, scene: Scene) -> None:
    """A bag of ROS 2 with boxes, calibrations and transforms, without images."""
    import ros_bags as ros

    still = [("map", f"{c.name}_optical", c.position, c.rotation) for c in scene.cameras]
    rows: list[ros.Row] = [("/tf_static", "tf2_msgs/msg/TFMessage", START, ros.transforms(START, *still))]
    by_camera = {c.name: rows_of(c.name) for c in scene.cameras}
    for frame in range(round(SECONDS * RATE)):
        t = START + frame * STEP_NS
        for camera in scene.cameras:
            k = intrinsic(camera)
            info = ros.camera_info(
                t, f"{camera.name}_optical", width=SIZE[0], height=SIZE[1], k=k.reshape(-1),
                p=np.insert(k, 3, 0, axis=1).reshape(-1),
            )  # fmt: skip
            seen = [(*r[2:], 0.9, "person", "") for r in by_camera[camera.name] if r[0] == frame]
            rows.append((f"/cam_{camera.name}/camera_info", "sensor_msgs/msg/CameraInfo", t, info))
            boxed = ros.detections(t, *seen)
            rows.append((f"/cam_{camera.name}/yolo/detections", "vision_msgs/msg/Detection2DArray", t, boxed))
    ros.write_mcap(path, rows)


STATIONS = {"north": (5.0, 9.0), "west": (0.5, 1.0), "east": (9.5, 1.5)}


def walk(seconds: float) -> tuple[float, float]:
    """Where one person walks who is measured by stations [m]."""
    return 2.5 + 1.0 * seconds, 3.0 + 0.6 * seconds


def stations(path: Path, first: str = "name") -> None:
    """Positions of the stations."""
    path.write_text(f"{first},x,y\n" + "".join(f"{name},{x},{y}\n" for name, (x, y) in STATIONS.items()))


def measured(path: Path, head: str, value: Callable[[float, float], str], *, name: bool = True) -> None:
    """A row for each station and time: of the difference to the station in x and y."""
    lines = [head]
    for step in range(round(SECONDS * RATE)):
        x, y = walk(step / RATE)
        for station, (a, b) in STATIONS.items():
            lines.append(f"{step / RATE:.1f},{station},{value(x - a, y - b)}" if name else value(x - a, y - b))
    path.write_text("\n".join(lines) + "\n")


def walk_csv(path: Path) -> None:
    """The true positions of the person who is measured by stations."""
    times = [step / RATE for step in range(round(SECONDS * RATE))]
    path.write_text("time,id,x,y\n" + "".join(f"{t:.1f},0,{walk(t)[0]:.4f},{walk(t)[1]:.4f}\n" for t in times))


def odas(folder: Path, hop: float = 0.008) -> None:
    """A stream of ODAS for each station, whose axes are the world's."""
    rng = np.random.default_rng(3)
    for station, (a, b) in STATIONS.items():
        lines = []
        for step in range(round(SECONDS * RATE)):
            x, y = walk(step / RATE)
            angle = np.arctan2(y - b, x - a) + np.radians(1.5) * rng.standard_normal()
            source = {"id": 1, "tag": "dynamic", "x": np.cos(angle), "y": np.sin(angle), "z": 0.0, "activity": 0.9}
            idle = {"id": 0, "tag": "", "x": 0.0, "y": 0.0, "z": 0.0, "activity": 0.0}
            stamp = round(step / RATE / hop)
            lines.append(json.dumps({"timeStamp": stamp, "src": [{k: _rounded(v) for k, v in source.items()}, idle]}))
        (folder / f"{station}_sst.json").write_text("\n".join(lines) + "\n")


def sound(folder: Path, azimuth_deg: float = 60.0, rate: int = 16000) -> None:
    """Noise from a direction at four microphones 0.1 m apart, and their positions."""
    microphones = np.array([[0.05, 0.05, 0], [-0.05, 0.05, 0], [-0.05, -0.05, 0], [0.05, -0.05, 0]])
    toward = np.array([np.cos(np.radians(azimuth_deg)), np.sin(np.radians(azimuth_deg)), 0.0])
    spectrum = np.fft.rfft(np.random.default_rng(1).standard_normal(rate))
    frequency = np.fft.rfftfreq(rate, 1 / rate)
    early = microphones @ toward / 343.0
    waves = [np.fft.irfft(spectrum * np.exp(2j * np.pi * frequency * t), rate) for t in early]
    wavfile.write(folder / "talk.wav", rate, (8000 * np.array(waves).T).clip(-32000, 32000).astype(np.int16))
    lines = [",".join(f"{v:g}" for v in row) for row in microphones]
    (folder / "table_microphones.csv").write_text("x,y,z\n" + "\n".join(lines) + "\n")


def _rounded(value: object) -> object:
    return round(float(value), 4) if isinstance(value, float | np.floating) else value


def recording(path: Path) -> None:
    """An occlog recording of the boxes in the hall, without a truth."""
    from occlog.io.recording.writer import RecordingWriter

    with RecordingWriter(path, hall("abc"), Provenance("test")) as writer:
        writer.table(found())


def truth_parquet(path: Path) -> None:
    """True positions as a table of occlog."""
    write_table(path, truth(SECONDS, people=PEOPLE), Provenance("test"))


def rendered(path: Path, frames: int = 40) -> Path:
    """A recording of a rendered room with people, three small cameras."""
    size = ["--frames", str(frames), "--fps", "10", "--size", "320x240", "--views", "3", "--people", "2"]
    assert run(["simulate", "--scene", "people", *size, "--seed", "3", "-o", str(path)]) == 0
    return path


def videos(folder: Path, source: Path, names: dict[str, str]) -> Scene:
    """Videos of a recording's cameras; the scene."""
    folder.mkdir(parents=True, exist_ok=True)
    opened = open_recording(source)
    assert opened.scene is not None
    for camera in opened.scene.cameras:
        out = cv2.VideoWriter(
            str(folder / names[camera.name]), cv2.VideoWriter.fourcc(*"mp4v"), RATE, camera.image_size or SIZE
        )
        for frame in opened.frames([camera.name]):
            out.write(frame.decode())
        out.release()
    return opened.scene


def pictures(folder: Path, source: Path) -> Scene:
    """A folder of images for each camera of a recording."""
    opened = open_recording(source)
    assert opened.scene is not None
    for camera in opened.scene.cameras:
        (folder / camera.name).mkdir(parents=True)
        for number, frame in enumerate(opened.frames([camera.name])):
            cv2.imwrite(str(folder / camera.name / f"{number:05d}.jpg"), frame.decode())
    return opened.scene


def litter(folder: Path) -> None:
    """What lies about: notes, thumbnails, a hidden folder, a spreadsheet."""
    (folder / "README.txt").write_text("Recorded in the hall on Monday.\nAsk Ann before use.\n")
    (folder / "notes.md").write_text("# To do\nAs text: frame,id,x,y,z (px). Ask Ann before use.\nTwo lines\n")
    (folder / "scene.md").write_text("# A scene\n```yaml\nocclog_scene: 1\n```\n")
    (folder / "thumbnails").mkdir()
    for number in range(4):
        cv2.imwrite(str(folder / "thumbnails" / f"thumb_{number}.jpg"), np.full((24, 32, 3), 60 * number, np.uint8))
    cv2.imwrite(str(folder / "plan.png"), np.zeros((24, 32, 3), np.uint8))
    (folder / ".git").mkdir()
    (folder / ".git" / "det.txt").write_text("1,-1,1,1,5,5,1,-1,-1,-1\n")
    (folder / "costs.csv").write_text("item,euro\ncamera,120\n")


def positions(path: Path) -> Truth:
    """True positions in a recording."""
    from occlog.io.open import open_input

    return open_input(path).read(Truth)
