"""Single people of WILDTRACK as labelled bearings: real boxes of seven cameras, made worse, and true places.

The annotations are not shipped; `OCCLOG_SHARED_DATA` names the folder that holds `wildtrack_annotations`.
"""

from __future__ import annotations

import csv
import os
from pathlib import Path
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.geometry.camera import wrap_angle
from occlog.io.formats.calibration.common import CalibrationOptions
from occlog.io.formats.calibration.reader import read_calibration
from occlog.measure.detect.bearing import shape_covariance, sights
from occlog.records.scene import Camera, Scene
from occlog.records.tables import Bearings

ROOT = Path(__file__).resolve().parents[2]
STEP_NS = 500_000_000
"""Two frames a second."""
LEAST, MOST = 40, 70
"""A person takes part who is there for so many frames in a row; the first ones of the longest run are used."""
VIEWS = 2
"""Cameras with a box of the person in every one of these frames."""
WIDTH = 1920.0
AREA = ((-3.0, -9.0), (9.0, -9.0), (9.0, 27.0), (-3.0, 27.0))
"""The ground on which people are annotated [m]."""


class Person(NamedTuple):
    """One person's bearings, which of them are false, and the truth."""

    target: int
    bearings: Bearings  # rows of all cameras and frames, by time and camera; `target_id` is 0
    false: Bools  # (R,) rows that are no bearing of the person
    t_ns: Ints  # (T,)
    xy: Floats  # (T, 2)


class Noise(NamedTuple):
    """How boxes are made worse."""

    px: float = 4.0  # standard deviation of a bearing [px]
    miss: float = 0.15  # probability that a camera does not see the person
    false: float = 0.05  # probability that a look gives a bearing uniform in the image, whatever there is to be seen
    sigma: str = "box"  # stated standard deviation: `box`, as `detect` does; `px`, the noise alone


def annotations() -> Path | None:
    """The folder of the annotations; None where it is missing."""
    path = Path(os.environ.get("OCCLOG_SHARED_DATA", ROOT.parent / "shared" / "data")) / "wildtrack_annotations"
    return path if path.is_dir() else None


def scene_of(folder: Path, *, room: bool = False) -> Scene:
    """The seven cameras; no room is known, as after `occlog ingest`, unless it is asked for."""
    options = CalibrationOptions(unit="m", image_size=(1920, 1080))
    cameras = read_calibration([folder / "calibration"], "auto", options).cameras
    return Scene(cameras, room=np.array(AREA)) if room else Scene(cameras)


def people(folder: Path, scene: Scene, noise: Noise, seed: int) -> list[Person]:
    """Everybody who is there for long enough, with bearings drawn from the seed."""
    boxes, truth = _rows(folder / "boxes_true.csv"), _rows(folder / "truth.csv")
    found = []
    for target in np.unique(truth[:, 3]).astype(int).tolist():
        own, at = boxes[boxes[:, 6] == target], truth[truth[:, 3] == target]
        frames = _longest_run(own, at)
        if len(frames) >= LEAST:
            rng = np.random.default_rng([seed, target])
            found.append(_person(target, frames[:MOST], own, at, scene, noise, rng))
    return found


def _rows(path: Path) -> Floats:
    """The numbers of a table, without columns of text."""
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    return np.array([[float(v) for k, v in row.items() if k != "role"] for row in rows])


def _longest_run(boxes: Floats, truth: Floats) -> Ints:
    """Frames of the longest run in which the place is known and enough cameras have a box."""
    views = np.bincount(boxes[:, 0].astype(int), minlength=int(truth[:, 0].max()) + 1)
    frames = np.unique(truth[:, 0]).astype(np.int64)
    frames = frames[views[frames] >= VIEWS]
    if not len(frames):
        return frames
    runs = np.split(frames, np.flatnonzero(np.diff(frames) > 1) + 1)
    return max(runs, key=len)


def _person(
    target: int, frames: Ints, boxes: Floats, truth: Floats, scene: Scene, noise: Noise, rng: np.random.Generator
) -> Person:
    """Draw the bearings of one person; a look is one camera in one frame."""
    tables, false = [], []
    for number, camera in enumerate(scene.cameras, start=1):
        own = boxes[(boxes[:, 1] == number) & np.isin(boxes[:, 0], frames)]
        box = np.full((len(frames), 4), np.nan)
        box[np.searchsorted(frames, own[:, 0].astype(np.int64))] = own[:, 2:6]
        part, wrong = _looks(camera, frames * STEP_NS, box, noise, rng)
        tables.append(part)
        false.append(wrong)
    # Bring the cameras' rows together in the order in which tables are merged
    together, wrong = Bearings.merge(tables), np.stack(false)
    camera = np.searchsorted(np.array([c.name for c in scene.cameras]), together.sensor)
    at = truth[np.searchsorted(truth[:, 0], frames)]
    wrong = wrong[camera, np.searchsorted(frames * STEP_NS, together.t_ns)]
    return Person(target, together, wrong, frames * STEP_NS, at[:, 1:3])


def _looks(camera: Camera, t_ns: Ints, box: Floats, noise: Noise, rng: np.random.Generator) -> tuple[Bearings, Bools]:
    """One camera's looks at boxes (T, 4) left, top, right, bottom, NaN where there is none; and which are false."""
    T = len(t_ns)
    chance = rng.random((3, T))
    false = chance[1] < noise.false
    seen = np.isfinite(box[:, 0]) & (chance[0] >= noise.miss) & ~false
    typical = np.nanmedian(box, axis=0) if np.isfinite(box).any() else np.array([900.0, 300.0, 960.0, 460.0])
    box = np.where(np.isfinite(box), box, typical)
    centre = 0.5 * (box[:, :2] + box[:, 2:])
    centre[:, 0] += noise.px * rng.standard_normal(T)
    centre[:, 0] = np.where(false, WIDTH * chance[2], centre[:, 0])
    size = box[:, 2:] - box[:, :2]
    spread = np.column_stack([size[:, 0] ** 2, np.zeros(T), size[:, 1] ** 2]) / 12.0
    stated = shape_covariance(spread, np.ones(T), np.zeros(T, dtype=np.bool_))
    if noise.sigma == "px":
        stated = np.tile([noise.px**2, 0.0, noise.px**2], (T, 1))
    at = sights(camera, centre, stated, spread, spread)
    there = seen | false
    columns = {"bearing": wrap_angle(at.bearing), "sigma": at.sigma, "u_px": at.u_px, "sigma_px": at.sigma_px}
    table = Bearings.of(
        t_ns=t_ns,
        sensor=np.full(T, camera.name),
        target_id=np.zeros(T, dtype=np.int32),
        seen=there,
        score=np.full(T, np.nan),
        **{name: np.where(there, values, np.nan) for name, values in columns.items()},
    )
    return table, false
