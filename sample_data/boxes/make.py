"""Makes the files beside it: `python sample_data/boxes/make.py FOLDER`.

Three people walk for 20 s in a room of 8 m x 6 m.  Two cameras in its corners see them with noise, miss a box in
twenty, and see nobody of whom another one hides more than half.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

FPS, FRAMES = 10, 200
SIZE = (1280, 720)
FOCAL_PX = 800.0
DISTORTION = np.array([-0.1, 0.02, 0.0, 0.0, 0.0])
HEIGHT_M, WIDTH_M = 1.75, 0.5
NOISE_PX, MISSED, HIDDEN = 2.0, 0.05, 0.5
CAMERAS = {"left": (0.0, 0.0, 2.5), "right": (8.0, 0.0, 2.5)}
LOOKED_AT = np.array([4.0, 4.0, 0.5])


def pose(centre: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation and translation with Xc = R Xw + t of a camera that looks at a point, its image upright."""
    forward = (LOOKED_AT - centre) / np.linalg.norm(LOOKED_AT - centre)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return rotation, -rotation @ centre


def places(t: np.ndarray) -> np.ndarray:
    """(3, n, 2) places of three people at times [s]: two circle in opposite directions, one crosses their ways."""
    return np.stack(
        [
            np.column_stack([4.0 + 1.6 * np.cos(0.5 * t), 3.6 + 1.4 * np.sin(0.5 * t)]),
            np.column_stack([4.0 + 2.4 * np.cos(1.0 - 0.35 * t), 3.4 + 1.8 * np.sin(1.0 - 0.35 * t)]),
            np.column_stack([4.0 + 2.5 * np.sin(0.3 * t), 3.0 + 0.5 * np.cos(0.6 * t)]),
        ]
    )


def box(place: np.ndarray, centre: np.ndarray, rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """Left, top, right, bottom [px] of somebody, as wide as a body that turns its broad side to the camera."""
    across = np.array([centre[1] - place[1], place[0] - centre[0]])
    across *= 0.5 * WIDTH_M / np.linalg.norm(across)
    corners = [[*(place + side * across), z] for side in (-1, 1) for z in (0.0, HEIGHT_M)]
    matrix = np.array([[FOCAL_PX, 0, SIZE[0] / 2], [0, FOCAL_PX, SIZE[1] / 2], [0, 0, 1.0]])
    turned = cv2.Rodrigues(rotation)[0]
    pixels = cv2.projectPoints(np.array(corners), turned, translation, matrix, DISTORTION)[0].reshape(-1, 2)
    return np.concatenate([pixels.min(axis=0), pixels.max(axis=0)])


def hidden(of: np.ndarray, by: np.ndarray) -> float:
    """Share of a box that another one covers."""
    size = np.minimum(of[2:], by[2:]) - np.maximum(of[:2], by[:2])
    return float(np.prod(np.clip(size, 0.0, None)) / np.prod(of[2:] - of[:2]))


def main(folder: Path) -> None:
    """Write boxes and calibration of each camera, and the truth."""
    random = np.random.default_rng(20)
    t = np.arange(FRAMES) / FPS
    walk = places(t)
    for name, at in CAMERAS.items():
        centre = np.array(at)
        rotation, translation = pose(centre)
        out = cv2.FileStorage(str(folder / f"{name}.yaml"), cv2.FILE_STORAGE_WRITE)
        for key, value in (("image_width", SIZE[0]), ("image_height", SIZE[1])):
            out.write(key, value)
        out.write("camera_matrix", np.array([[FOCAL_PX, 0, SIZE[0] / 2], [0, FOCAL_PX, SIZE[1] / 2], [0, 0, 1]]))
        out.write("distortion_coefficients", DISTORTION.reshape(1, -1))
        out.write("R", rotation)
        out.write("T", translation.reshape(-1, 1))
        out.release()
        rows = ["frame,left,top,width,height,confidence"]
        for k in range(FRAMES):
            there = [box(place, centre, rotation, translation) for place in walk[:, k]]
            near = [float(np.linalg.norm(place - centre[:2])) for place in walk[:, k]]
            for n in random.permutation(len(there)):
                edges = there[n] + random.normal(0.0, NOISE_PX, 4)
                covered = [hidden(there[n], there[m]) for m in range(len(there)) if near[m] < near[n]]
                seen, sure = random.random() > MISSED, random.uniform(0.6, 0.99)
                if seen and max(covered, default=0.0) < HIDDEN:
                    left, top, right, bottom = edges
                    rows.append(f"{k},{left:.1f},{top:.1f},{right - left:.1f},{bottom - top:.1f},{sure:.2f}")
        (folder / f"{name}.csv").write_text("\n".join(rows) + "\n")
    rows = ["time,id,x,y"]
    rows += [f"{t[k]:.1f},{n},{walk[n, k, 0]:.4f},{walk[n, k, 1]:.4f}" for k in range(FRAMES) for n in range(len(walk))]
    (folder / "truth.csv").write_text("\n".join(rows) + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
