"""[Ercan] Sec. 7 on recorded detections: virtual occluders hide the target of a recording, and a filter tracks it.

Virtual people walk through the room.  A camera whose sight line to the target is crossed by one of
them reports "not seen" instead of its detection.  `target` finds the target's own
detections and its true path.  A trial is described by plain values, so that any process can run it.

The data set cmc_detections is read as it is shipped: boxes of a person detector in four views, and
their calibration.  Other recordings come as a table of bearings and a scene.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools
from occlog.core.sight.visibility import behind_objects
from occlog.errors import InputError, UsageError
from occlog.io.boxes.reader import BoxFile, BoxOptions, read_boxes, survey_boxes
from occlog.io.calibration.common import CalibrationOptions
from occlog.io.calibration.reader import read_calibration
from occlog.io.files.provenance import hash_file
from occlog.io.files.tables.parquet import read_table
from occlog.io.files.times.frame_times import FrameTimes, as_rate
from occlog.io.open import scene_in
from occlog.measure.detect.from_boxes import detect_boxes
from occlog.measure.priors.from_positions import virtual_priors
from occlog.papers.ercan.recorded.target import SKIP, Recorded, recorded_target, unseen
from occlog.papers.ercan.scenes import LAB_SIZE
from occlog.papers.verdicts.model import Size
from occlog.pipeline.sweep.trial import Spec, rmse_of_priors
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Boxes, Occluders, Tracks, Truth
from occlog.scans.occluder_priors import known_positions
from occlog.simulate.config import WorldConfig
from occlog.simulate.stage import simulate_truth
from occlog.track.apf.config import ApfConfig
from occlog.track.apf.selection_config import SelectConfig, read_selection
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import Tracking

TABLE = "CMC1_detections.csv"
"""CMC1 has one walking target; in CMC2 people cannot be told apart, and CMC4 has a short path only."""
CALIBRATION = "calibration"
IMAGE = (1920, 1024)
RATE = "6.5"
"""Frames a second.  The recording does not state it; at this rate its target walks at 1.2 m/s."""
ROOM = ((0.0, 0.0), (7.67, 0.0), (7.67, 3.41), (0.0, 3.41))
"""Corners of the room [m], from the recording's description."""
OCCLUDERS = 20
"""Occluders of the paper's lab.  A room of known size gets as many a square metre, others this number."""
MOST = 100
"""Largest number of virtual people."""
INCH = 0.0254
"""Metres in an inch; the paper's lab is measured in inches."""
DIAMETER = 12 * INCH
SIGMA, Q = 12.8 * INCH, 24 * INCH
"""Deviation and motion noise of the occluders' virtual measurements [m], as in the stand-in for the lab."""
DETECTION, FALSE = 0.9, 0.05
"""Probabilities of detection and of a false report that the filter assumes of recorded detectors.

Without priors it assumes no probability of detection, as in the paper: "not seen" then says
nothing.  With one it would take every hidden camera for a rare miss.
"""
START_SIGMA = 0.5
"""Deviation of the filters' start about the first true place [m]; without a start they search for long."""
CLEAR = "clear"
"""Kind of a trial without virtual people: its error comes from the cameras' geometry and noise alone."""


class Source(NamedTuple):
    """Files of a recording by absolute paths, and hashes of their content."""

    data: str  # folder of cmc_detections; empty: `bearings` and `scene` are given
    bearings: str
    scene: str
    content: tuple[str, ...]  # SHA-256 of each file


def cmc_files(data: Path) -> Source:
    """Name the files of a folder of cmc_detections; InputError for missing ones."""
    return Source(str(data.resolve()), "", "", tuple(hash_file(p) for p in _files(data)))


def files_of(bearings: Path, scene: Path) -> Source:
    """Name the files of a recording given as bearings and a scene; InputError for missing ones."""
    return Source("", str(bearings.resolve()), str(scene.resolve()), (hash_file(bearings), hash_file(scene)))


def read_source(source: Source) -> tuple[Scene, Bearings]:
    """Read scene and bearings of a recording; UsageError if its scene is a recording without one."""
    if source.data:
        return read_cmc(Path(source.data))
    path = Path(source.scene)
    scene = scene_in(path)
    if scene is None:
        raise UsageError(f"{path}: this recording holds no scene; give a scene file instead")
    return scene, read_table(Path(source.bearings), Bearings)


def read_cmc(folder: Path) -> tuple[Scene, Bearings]:
    """Read CMC1 as `ingest` and `detect` do: scene and unlabelled bearings; InputError for missing files."""
    table, *calibration = _files(folder)
    cameras = read_calibration(calibration, "projection", CalibrationOptions(None, IMAGE)).cameras
    scene = replace(Scene(), cameras=cameras, room=np.array(ROOM))
    files, known, options = [BoxFile(table, None)], [c.name for c in cameras], BoxOptions()
    survey = survey_boxes(files, known, options)
    times = dict.fromkeys(survey.cameras, FrameTimes("assumed frame rate", rate=as_rate(RATE)))
    boxes = read_boxes(files, survey, times, known, options, Boxes)
    return scene, Bearings.concat([found.bearings for found in detect_boxes(boxes, scene)])


def _files(folder: Path) -> list[Path]:
    """Return the table and the calibration files of cmc_detections; InputError if one of them is missing."""
    table, calibration = folder / TABLE, folder / CALIBRATION
    for path, there in ((table, table.is_file()), (calibration, calibration.is_dir())):
        if not there:
            raise InputError(f"{path}: not found; give the folder of cmc_detections")
    return [table, *sorted(p for p in calibration.iterdir() if p.is_file() and not p.name.startswith("."))]


class Crowd(NamedTuple):
    """The virtual people of a run, and the recording that they leave."""

    people: Truth
    gone: Bools  # rows of the bearings whose detection is dropped
    left: Bearings  # all rows, "not seen" where the detection is dropped
    priors: dict[str, Occluders | None]  # by kind: none, known, kalman


def crowd_size(scene: Scene) -> int:
    """Return the number of virtual people in a scene."""
    if scene.room is None:
        return OCCLUDERS
    x, y = scene.room.T
    area = 0.5 * abs(float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))))
    return min(MOST, max(1, round(OCCLUDERS * area / (LAB_SIZE[0] * LAB_SIZE[1] * INCH**2))))


def occluders_of(recorded: Recorded, seed: int) -> Truth:
    """Draw virtual people, as dense and as thick as in the paper's lab, from the recording's first to its last time."""
    t_ns, scene = recorded.places.t_ns, recorded.scene
    span = int(t_ns[-1] - t_ns[0])
    # Steps of equal length, close to the median: people of a recording of constant rate have the times of its frames.
    steps = max(1, round(span / float(np.median(np.diff(t_ns)))))
    config: WorldConfig = replace(
        WorldConfig.in_unit("m"),
        steps=steps + 1,
        step_s=span / steps * 1e-9,
        targets=0,
        occluders=crowd_size(scene),
        diameter=DIAMETER,
        start_ns=int(t_ns[0]),
    )
    return Truth.concat(list(simulate_truth(scene, config, seed)))


def hidden(recorded: Recorded, people: Truth, diameter: float = DIAMETER) -> Bools:
    """Return (n,) true for bearings whose sight line to the target a person crosses ([Ercan] Fig. 3, A(x))."""
    bearings, places = recorded.bearings, recorded.places
    times = np.unique(people.t_ns)
    crowd = np.column_stack([people.x, people.y]).reshape(len(times), -1, 2)
    now = np.clip(np.searchsorted(times, bearings.t_ns, side="right") - 1, 0, None)
    target = np.column_stack([places.x, places.y])[np.searchsorted(places.t_ns, bearings.t_ns)]
    out = np.zeros(len(bearings), dtype=np.bool_)
    for camera in recorded.scene.cameras:
        rows = np.flatnonzero((bearings.sensor == camera.name) & bearings.seen)
        out[rows] = behind_objects(camera.ground, target[rows], crowd[now[rows]], diameter)
    return out


def crowd_of(recorded: Recorded, seed: int) -> Crowd:
    """Draw the virtual people of a seed, the same for all settings, and drop the detections that they hide."""
    people = occluders_of(recorded, seed)
    gone = hidden(recorded, people)
    priors = {
        "none": None,
        "known": Occluders.concat(list(known_positions([people]))),
        "kalman": Occluders.concat(list(virtual_priors([people], SIGMA, Q, seed))),
    }
    return Crowd(people, gone, unseen(recorded.bearings, gone), priors)


def trial(
    recorded: Recorded,
    crowd: Crowd,
    kind: str,
    cameras: Sequence[str],
    size: Size,
    seed: int,
    select: SelectConfig | None = None,
) -> dict[str, float]:
    """Track the target among virtual people and compare with its path.

    Args:
        recorded: the target.
        crowd: the people.
        kind: priors of the people: none, known or kalman; or `CLEAR`.
        cameras: names of the cameras that are used.
        size: particles, and number of the recording's times that are used.
        seed: of the filter.
        select: policy of selection among the cameras; None: all are used.

    Returns:
        `rmse` [m], `rmse_occ` [m] (of the priors' means; NaN without priors), and `hidden`, the share of
        the detections that are dropped.
    """
    last = recorded.places.t_ns[min(size.steps, len(recorded.places)) - 1]
    table = recorded.bearings if kind == CLEAR else crowd.left
    used = (table.t_ns <= last) & np.isin(table.sensor, list(cameras))
    priors = crowd.priors.get(kind)
    tracking = Tracking(settings_of(recorded, size, kind), seed, sensors=frozenset(cameras), selection=select)
    parts = track([table.take(used)], recorded.scene, tracking, None if priors is None else [priors])
    rmse = _error(recorded, Tracks.concat([p.tracks for p in parts]))
    lost = crowd.gone[used & recorded.bearings.seen]
    share = float(np.mean(lost)) if kind != CLEAR and len(lost) else 0.0
    return {"rmse": rmse, "rmse_occ": rmse_of_priors(priors, crowd.people), "hidden": share}


def settings_of(recorded: Recorded, size: Size, kind: str) -> ApfConfig:
    """Return the settings of a trial's filter."""
    return replace(
        ApfConfig.in_unit("m"),
        particles=size.particles,
        detection=None if kind == "none" else DETECTION,
        false=FALSE,
        occluder_diameter=DIAMETER,
        start=(*recorded.start.tolist(), START_SIGMA),
    )


def _error(recorded: Recorded, tracks: Tracks) -> float:
    """Return the root mean square distance from the stand-in for the truth, without the first `SKIP` estimates."""
    places, tracks = recorded.places, tracks.take(slice(SKIP, None))
    if not len(tracks):
        raise InputError(f"no more than {SKIP} estimates, which are left out; give more steps or more cameras")
    row = np.searchsorted(places.t_ns, tracks.t_ns)
    return float(np.sqrt(np.mean((tracks.x - places.x[row]) ** 2 + (tracks.y - places.y[row]) ** 2)))


def recorded_spec(source: Source, size: Size, run: int, kind: str, cameras: list[str], **more: object) -> Spec:
    """Describe a trial for `recorded_trial`."""
    return {
        "recording": {**source._asdict(), "content": list(source.content)},
        "seed": size.seed + run,
        "steps": size.steps,
        "particles": size.particles,
        "kind": kind,
        "cameras": cameras,
        **more,
    }


def recorded_trial(spec: Spec) -> dict[str, float]:
    """Run the trial that `recorded_spec` describes; see `trial`.

    Args:
        spec: `recording` (fields of `Source`), `seed` (of the virtual people and of the
            filter), `steps`, `particles`, `kind`, `cameras`, and optional `select` (fields
            of `SelectConfig`).
    """
    source = Source(**{**spec["recording"], "content": tuple(spec["recording"]["content"])})
    seed = int(spec["seed"])
    select = None if spec.get("select") is None else read_selection(spec["select"])
    size = Size(1, int(spec["steps"]), particles=int(spec["particles"]))
    return trial(
        target_of(source),
        _crowd(source, seed),
        kind=spec["kind"],
        cameras=spec["cameras"],
        size=size,
        seed=seed,
        select=select,
    )


@functools.lru_cache(maxsize=1)
def target_of(source: Source) -> Recorded:
    """Return the target of a recording; the last one is kept, as all trials of a process have the same."""
    return recorded_target(*read_source(source))


@functools.lru_cache(maxsize=2)
def _crowd(source: Source, seed: int) -> Crowd:
    return crowd_of(target_of(source), seed)
