"""People who walk in a room of 10 x 8 m, and the boxes that cameras of known poses make of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from occlog.array_types import NS, Floats
from occlog.calibrate.kernels import expected_boxes
from occlog.io.formats.scenes.scene import scene_to_yaml
from occlog.records.scene import Camera, Scene, camera_rotation
from occlog.track.methods.jipda.interface import FrameDetections
from occlog.track.methods.jipda.kernels.body_box import pack_views
from occlog.track.people.frame_detections import FrameDetectionsWithIds

FPS, SIZE = 5.0, (1280, 720)


def cameras() -> list[Camera]:
    """Three cameras in corners."""
    poses = [((-1.0, -1.0, 3.0), 40.0), ((11.0, -0.5, 2.6), 140.0), ((5.0, 9.5, 3.4), -92.0)]
    principal = np.array([639.5, 359.5])
    return [
        Camera(
            f"cam{k}", np.array(position), camera_rotation(np.radians(yaw), np.radians(-18.0), 0.01 * k),
            np.array([800.0, 800.0]), principal, SIZE,
        )
        for k, (position, yaw) in enumerate(poses)
    ]  # fmt: skip


def people(t: Floats, count: int = 4) -> Floats:
    """(T, P, 2) positions at times [s]: sums of sines."""
    rng = np.random.default_rng(3)
    phase, slow = rng.uniform(0.0, 2.0 * np.pi, (count, 2, 2)), rng.uniform(0.15, 0.45, (count, 2, 2))
    waves = np.sin(slow * t[:, None, None, None] + phase)
    return np.asarray([5.0, 4.0] + waves @ np.array([0.7, 0.3]) * [4.2, 3.2])


def boxes(camera: Camera, t: Floats, rng: np.random.Generator, noise_px: float = 2.0) -> list[Floats]:
    """Boxes (n, 4) in a camera at each time."""
    at = people(t)
    state = np.zeros((at.shape[0] * at.shape[1], 6))
    state[:, :2] = at.reshape(-1, 2)
    state[:, 4], state[:, 5] = np.tile([1.62, 1.68, 1.74, 1.76], len(t)), 0.5
    n = len(state)
    out = np.zeros((n, 4))
    expected_boxes(pack_views([camera]).lens, np.zeros(n, dtype=np.int64), state, np.zeros(n), out)
    out += rng.normal(0.0, noise_px, out.shape)
    inside = (
        np.isfinite(out).all(axis=1) & (out[:, :2] > 0.0).all(axis=1) & (out[:, 2:] < np.array(SIZE) - 1.0).all(axis=1)
    )
    return [part[keep] for part, keep in zip(out.reshape(len(t), -1, 4), inside.reshape(len(t), -1), strict=True)]


def frames(late: Floats, seconds: float = 30.0) -> list[FrameDetectionsWithIds]:
    """Frames of all cameras, stamped by clocks that are late by some seconds each."""
    t, rng, out = np.arange(0.0, seconds, 1.0 / FPS), np.random.default_rng(5), []
    row = 0
    for c, camera in enumerate(cameras()):
        for k, found in enumerate(boxes(camera, t, rng)):
            n = len(found)
            stamp = round((t[k] + late[c]) * NS)
            none = np.full(n, np.nan), np.full(n, -1), np.zeros((n, 0)), np.arange(row, row + n)
            out.append(FrameDetectionsWithIds(FrameDetections(stamp, c, found, *none), k, np.arange(n)))
            row += n
    return sorted(out, key=lambda each: each.detections.t_ns)


def write(folder: Path, stated: list[Camera]) -> list[str]:
    """Files of boxes and of the scene; arguments of `ingest`."""
    t, rng = np.arange(0.0, 30.0, 1.0 / FPS), np.random.default_rng(5)
    rows = ["camera,frame,left,top,right,bottom"]
    for camera in cameras():
        rows += [
            f"{camera.name},{k}," + ",".join(f"{v:.2f}" for v in box)
            for k, found in enumerate(boxes(camera, t, rng))
            for box in found
        ]
    (folder / "boxes.csv").write_text("\n".join(rows) + "\n")
    (folder / "rough.yaml").write_text(scene_to_yaml(Scene(tuple(stated))))
    return ["--boxes", str(folder / "boxes.csv"), "--scene", str(folder / "rough.yaml"), "--fps", f"{FPS:g}"]
