"""A hall with calibrated cameras, people who walk in it, and the boxes that a detector could have made of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from occlog.core.geometry.camera import rotation_from_angles
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.scenes.scene import scene_to_yaml
from occlog.records.scene import Camera, Scene, camera_fov
from occlog.records.tables import Boxes, Truth

STEP_NS = 100_000_000
SIZE = (640, 480)
FOCAL = 420.0
CORNERS = {"a": (0.0, 0.0, 45.0), "b": (10.0, 0.0, 135.0), "c": (10.0, 10.0, -135.0), "d": (0.0, 10.0, -45.0)}
PEOPLE = 4
HEIGHT, WIDTH = 1.75, 0.5


def camera(name: str, metre: float = 1.0, **other: object) -> Camera:
    """A camera in a corner of the hall, 3 m high, that points at its middle."""
    x, y, yaw = CORNERS[name]
    focal, principal = np.array([FOCAL, FOCAL]), np.array([319.5, 239.5])
    rotation = rotation_from_angles(np.radians(yaw), np.radians(-20.0), 0.0)
    values: dict[str, object] = {
        "position": metre * np.array([x, y, 3.0]),
        "rotation": rotation,
        "focal_px": focal,
        "principal_px": principal,
        "image_size": SIZE,
        "fov": camera_fov(SIZE, focal, principal, np.zeros(5), "brown", rotation),
        **other,
    }
    return Camera(name, **values)  # type: ignore[arg-type]


def hall(names: str = "abc", metre: float = 1.0, unit: str = "m") -> Scene:
    """The hall; lengths in a unit of which so many are a metre."""
    room = metre * np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
    return Scene(cameras=tuple(camera(name, metre) for name in names), room=room, length_unit=unit)


def place(person: int, seconds: float) -> tuple[float, float]:
    """Where somebody walks [m]: on circles of their own about the middle, at 1.0 to 1.4 m/s."""
    radius = 1.6 + 0.7 * person
    angle = 1.57 * person + (1.0 + 0.1 * person) / radius * seconds * (-1) ** person
    return 5.0 + radius * float(np.cos(angle)), 5.0 + radius * float(np.sin(angle))


def outlines(of: Camera, xy: NDArray[np.float64], metre: float = 1.0) -> NDArray[np.float64]:
    """(n, 4) left, top, right, bottom of upright ellipsoids at `xy` (n, 2) [m]; NaN behind the camera."""
    a, b = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 24), np.linspace(0.0, np.pi, 13))
    around = np.column_stack([(np.sin(b) * np.cos(a)).ravel(), (np.sin(b) * np.sin(a)).ravel(), np.cos(b).ravel()])
    middles = np.column_stack([xy, np.full(len(xy), 0.5 * HEIGHT)])
    points = middles[:, None] + around * np.array([0.5 * WIDTH, 0.5 * WIDTH, 0.5 * HEIGHT])
    pixels = of.project(metre * points.reshape(-1, 3)).reshape(len(xy), len(around), 2)
    return np.column_stack([pixels.min(axis=1), pixels.max(axis=1)])


def box(of: Camera, x: float, y: float, metre: float = 1.0) -> NDArray[np.float64]:
    """(4,) left, top, right, bottom of an upright ellipsoid; NaN behind the camera."""
    return outlines(of, np.array([[x, y]]), metre)[0]


def boxes(
    scene: Scene,
    seconds: float = 10.0,
    *,
    metre: float = 1.0,
    miss: float = 0.1,
    px: float = 1.5,
    late: dict[str, float] | None = None,
    people: int = PEOPLE,
    step_ns: int = STEP_NS,
    seed: int = 0,
) -> Boxes:
    """Boxes of everybody whose middle is in the image, with noise and misses; people are the box's identity.

    Args:
        scene: the hall.
        seconds: how long.
        metre: units of length in a metre.
        miss: probability that a box is missing.
        px: standard deviation of the edges.
        late: by how many seconds what a camera shows is old.
        people: how many.
        step_ns: time between frames.
        seed: of noise and misses.
    """
    rng = np.random.default_rng(seed)
    rows: list[tuple[float, ...]] = []
    sensors: list[str] = []
    frames = range(round(seconds * 1e9) // step_ns)
    shown = {}
    for cam in scene.cameras:
        then = [f * step_ns * 1e-9 - (late or {}).get(cam.name, 0.0) for f in frames]
        xy = np.array([place(k, t) for t in then for k in range(people)]).reshape(-1, 2)
        shown[cam.name] = outlines(cam, xy, metre).reshape(len(frames), people, 4)
    for frame in frames:
        t_ns = frame * step_ns
        for cam in scene.cameras:
            found = []
            for k, edges in enumerate(shown[cam.name][frame]):
                middle = 0.5 * (edges[:2] + edges[2:])
                inside = np.isfinite(edges).all() and (middle > 0).all() and (middle < SIZE).all()
                noise, missed = px * rng.standard_normal(4), rng.random() < miss
                if inside and not missed:
                    found.append((k, edges + noise))
            for n, (k, e) in enumerate(found):
                rows.append((t_ns, frame, n, k, e[0], e[1], e[2] - e[0], e[3] - e[1], 0.9))
            if not found:
                rows.append((t_ns, frame, -1, -1, *[np.nan] * 5))
            sensors += [cam.name] * max(len(found), 1)
    return table(sensors, np.array(rows).reshape(-1, 9))


def table(sensors: list[str], rows: NDArray[np.float64]) -> Boxes:
    """Boxes of columns time, frame, box, identity, left, top, width, height, confidence."""
    return Boxes.of(
        t_ns=rows[:, 0].astype(np.int64),
        sensor=np.array(sensors, dtype=np.str_),
        frame=rows[:, 1].astype(np.int64),
        box=rows[:, 2].astype(np.int32),
        target_id=rows[:, 3].astype(np.int32),
        left_px=rows[:, 4],
        top_px=rows[:, 5],
        width_px=rows[:, 6],
        height_px=rows[:, 7],
        confidence=rows[:, 8],
    )


def truth(seconds: float = 10.0, *, metre: float = 1.0, people: int = PEOPLE, step_ns: int = STEP_NS) -> Truth:
    """Where everybody is at the times of the frames."""
    at = [(f * step_ns, k) for f in range(round(seconds * 1e9) // step_ns) for k in range(people)]
    positions = metre * np.array([place(k, t * 1e-9) for t, k in at])
    nothing = np.full(len(at), np.nan)
    return Truth.of(
        t_ns=np.array([t for t, _ in at], dtype=np.int64),
        target_id=np.array([k for _, k in at], dtype=np.int32),
        role=np.full(len(at), "target"),
        x=positions[:, 0],
        y=positions[:, 1],
        z=nothing,
    )


def written(folder: Path, found: Boxes, scene: Scene) -> tuple[str, str]:
    """Paths of a table of boxes and of a scene, written into a folder."""
    boxes_path, scene_path = folder / "boxes.parquet", folder / "hall.yaml"
    write_table(boxes_path, found, Provenance("test"), overwrite=True)
    scene_path.write_text(scene_to_yaml(scene))
    return str(boxes_path), str(scene_path)
