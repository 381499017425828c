"""[Ercan] Sec. 7 on recorded detections that virtual occluders hide.

[Ercan] Sec. 7 on recorded detections: virtual occluders hide the target of a recording, and a filter tracks it.

Virtual people walk through the room.  A camera with a line of sight to the target that is crossed by one of
them reports "not seen" instead of its detection.  `target` finds the target's own
detections and its true path.  A trial is described by plain values, so that any process can run it.

The data set cmc_detections is read as it is shipped: boxes of a person detector in four views, and
their calibration.  Other recordings come as a table of bearings and a scene.

[Ercan] Figs. 14 and 15 on recorded detections that virtual occluders hide.

The target of a recording without ground truth: its own detections, and a stand-in for its true path.

A filter over the detections of all cameras finds the target; of each camera's detections the one
nearest to its track is the target's own.  The stand-in for the true path uses no filter: it is the
points at which the lines of sight of these detections meet, smoothed over the meetings before and after.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.geometry.triangulate import TRIANGULATED
from occlog.core.geometry.visibility import behind_objects
from occlog.errors import InputError, UsageError
from occlog.evaluate.bearings.residuals import triangulated_points
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.io.files.provenance import hash_file
from occlog.io.files.tables.parquet import read_table
from occlog.io.files.timing.frame_times import FrameTimes, as_rate
from occlog.io.formats.boxes.reader import BoxFile, BoxOptions, read_boxes, survey_boxes
from occlog.io.formats.calibration.common import CalibrationOptions
from occlog.io.formats.calibration.reader import read_calibration
from occlog.io.open import scene_in
from occlog.measure.associate.config import LabelConfig
from occlog.measure.associate.stage import label
from occlog.measure.detect.from_boxes import detect_boxes
from occlog.measure.priors.from_positions import virtual_priors
from occlog.papers.verdicts import Execute, Experiment, PaperRow, Size, StatementVerdict, Table
from occlog.pipeline.sweep.trial import Spec, rmse_of_priors
from occlog.records.scene import Scene
from occlog.records.tables import UNLABELLED, Bearings, Boxes, Occluders, Tracks, Truth
from occlog.scans.occluder_priors import known_positions
from occlog.simulate.config import WorldConfig
from occlog.simulate.stage import simulate_truth
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.methods.apf.config import ApfConfig, SelectConfig, read_selection

from .selection import ALL, BRUTE, CLOSEST, FIXED, GREEDY, RANDOM, judge_greedy
from .trial import KNOWN, LAB_SIZE, NONE, PRIOR, judge_cameras, judge_priors

TARGET = 0
GATE = 3.0
"""Largest distance of the target's own detection from its track, in standard deviations."""
SKIP = 10
"""Estimates skipped at the start, while a filter finds the target."""
LINES = 3
"""Lines of sight that must meet (two, where a recording has no more cameras)."""
MEETINGS = 7
"""Meetings, the nearest in time, to which a parabola is fitted."""


@dataclass(frozen=True)
class Recorded:
    """A recorded target: scene, its own labelled bearings, and the stand-in for its true path at all their times."""

    scene: Scene
    bearings: Bearings  # of the target alone, labelled
    positions: Truth  # the stand-in for the truth, at every time of the bearings

    @property
    def start(self) -> Floats:
        """First position (2,) of the target [m]."""
        return np.array([self.positions.x[0], self.positions.y[0]])

    @property
    def cameras(self) -> tuple[str, ...]:
        """Cameras that saw the target at least once, in the order of the scene."""
        seen = set(self.bearings.sensor[self.bearings.seen].tolist())
        return tuple(c.name for c in self.scene.cameras if c.name in seen)


def recorded_target(scene: Scene, bearings: Bearings) -> Recorded:
    """Find the target of a recording in metres, with its own detections and the stand-in for its true path.

    InputError if the unit is another one, or there are too few detections, or cameras that detect it.

    Args:
        scene: scene with cameras that have poses.
        bearings: labelled or not; of labelled ones only those of the first target are used.
    """
    if scene.length_unit != "m":
        raise InputError(
            f"the recording is in {scene.length_unit}, the experiment requires metres; give a scene in m",
            id="unit-mismatch",
        )
    config = replace(ApfConfig.in_unit("m"), particles=4000)
    tracks = Tracks.concat([p.tracks for p in track([bearings], scene, TrackingTask(config, 0))])
    if len(tracks) <= SKIP + 1:
        raise InputError(
            f"{len(tracks)} times with detections, expected more than {SKIP + 1}; give a longer recording",
            id="insufficient-data",
        )
    target = tracks.target_id[0]
    tracks = tracks.take(tracks.target_id == target)
    own = np.isin(bearings.target_id, (UNLABELLED, target)) & np.isin(bearings.t_ns, tracks.t_ns)
    mine = assign(scene, bearings.take(own), tracks)
    found = set(mine.sensor[mine.seen].tolist())
    if len(found) < 2:
        raise InputError(
            f"{len(found)} cameras saw the target, expected at least 2; give bearings of more", id="too-few-sensors"
        )
    positions = stand_in(scene, mine, min(LINES, len(found)))
    return Recorded(scene, mine.take(np.isin(mine.t_ns, positions.t_ns)), positions)


def assign(scene: Scene, bearings: Bearings, tracks: Tracks) -> Bearings:
    """One row for every camera and frame: its detection nearest to the track, or "not seen" if none is in the gate.

    Labels of the detections are not used.  Microphone arrays are skipped.
    """
    own = bearings.take(np.isin(bearings.sensor, [c.name for c in scene.cameras]))
    free = replace(own, target_id=np.full(len(own), UNLABELLED, dtype=np.int32))
    path = replace(tracks, target_id=np.full(len(tracks), TARGET, dtype=np.int32))
    return Bearings.concat([part.bearings for part in label([free], [path], scene, LabelConfig(gate=GATE))])


def unseen(bearings: Bearings, rows: Bools) -> Bearings:
    """Bearings with some rows, selected by the mask `rows` (n,), changed to "not seen"."""
    nothing = {
        n: np.where(rows, np.nan, getattr(bearings, n)) for n in ("bearing", "sigma", "u_px", "sigma_px", "score")
    }
    return replace(bearings, seen=bearings.seen & ~rows, **nothing)


def stand_in(scene: Scene, mine: Bearings, lines: int) -> Truth:
    """Path of the target from the first intersection of its lines of sight to the last, smoothed, as truth.

    Args:
        scene: scene with cameras that have poses.
        mine: the target's own bearings, at the times of which it is placed.
        lines: number of lines of sight that must intersect, at least 2.

    Raises:
        InputError: too few intersections to smooth.
    """
    met = triangulated_points(mine, scene, EvaluateConfig(triangulation_min_sensors=lines))[TARGET]
    good = met.status == TRIANGULATED
    if good.sum() < MEETINGS:
        raise InputError(
            f"{lines} lines of sight met at {good.sum()} times, expected at least {MEETINGS}; give a longer recording",
            id="insufficient-data",
        )
    at, xy = met.t_ns[good], met.xy[good]
    weight = 1.0 / np.sqrt(met.covariance[good, 0, 0] + met.covariance[good, 1, 1])
    times = np.unique(mine.t_ns)
    times = times[(times >= at[0]) & (times <= at[-1])]
    positions = smoothed(at, xy, weight, times)
    n = len(times)
    return Truth.of(
        t_ns=times,
        target_id=np.full(n, TARGET),
        role=["target"] * n,
        x=positions[:, 0],
        y=positions[:, 1],
        z=np.full(n, np.nan),
    )


def smoothed(at: Ints, xy: Floats, weight: Floats, times: Ints) -> Floats:
    """(n, 2) positions at `times` on parabolas fitted to the `MEETINGS` nearest points by weighted least squares.

    Args:
        at: (S,) increasing times of the points [ns], at least `MEETINGS` of them.
        xy: (S, 2) points.
        weight: (S,) inverse standard deviations of the points.
        times: (n,) times [ns] from the first of `at` to the last.
    """
    out = np.empty((len(times), 2))
    for i, t in enumerate(times.tolist()):
        near = np.argsort(np.abs(at - t), kind="stable")[:MEETINGS]
        since = (at[near] - t) * 1e-9
        rows = np.column_stack([np.ones(MEETINGS), since, since**2]) * weight[near, None]
        out[i] = np.linalg.lstsq(rows, xy[near] * weight[near, None], rcond=None)[0][0]
    return out


TABLE = "CMC1_detections.csv"
"""CMC1 has one walking target; in CMC2 people cannot be distinguished, and CMC4 has a short path only."""
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

Without priors it assumes no probability of detection, as in the paper: "not seen" then states
nothing.  With one it would take every hidden camera for a rare miss.
"""
START_SIGMA = 0.5
"""Deviation of the filters' start about the first true position [m]; without a start they search for long."""
CLEAR = "clear"
"""Kind of a trial without virtual people: its error comes from the cameras' geometry and noise alone."""


class RecordedFiles(NamedTuple):
    """Files of a recording by absolute paths, and the SHA-256 of each.

    Either the folder `data` of cmc_detections, or `bearings` and `scene`; the others are empty.
    """

    data: str  # folder of cmc_detections; empty: `bearings` and `scene` are given
    bearings: str
    scene: str
    content: tuple[str, ...]  # SHA-256 of each file


def cmc_files(data: Path) -> RecordedFiles:
    """Name the files of a folder of cmc_detections; InputError for missing ones."""
    return RecordedFiles(str(data.resolve()), "", "", tuple(hash_file(p) for p in _files(data)))


def files_of(bearings: Path, scene: Path) -> RecordedFiles:
    """Name the files of a recording given as bearings and a scene; InputError for missing ones."""
    return RecordedFiles("", str(bearings.resolve()), str(scene.resolve()), (hash_file(bearings), hash_file(scene)))


def read_source(source: RecordedFiles) -> tuple[Scene, Bearings]:
    """Read scene and bearings of a recording; UsageError if its scene is a recording without one."""
    if source.data:
        return read_cmc(Path(source.data))
    path = Path(source.scene)
    scene = scene_in(path)
    if scene is None:
        raise UsageError(f"{path}: this recording holds no scene; give a scene file instead", id="missing-scene")
    return scene, read_table(Path(source.bearings), Bearings)


def read_cmc(folder: Path) -> tuple[Scene, Bearings]:
    """Read the recording CMC1 of a folder as `ingest` and `detect` do: scene and unlabelled bearings.

    InputError for missing files.
    """
    table, *calibration = _files(folder)
    cameras = read_calibration(calibration, "projection", CalibrationOptions(None, IMAGE)).cameras
    scene = replace(Scene(), cameras=cameras, room=np.array(ROOM))
    files, known, options = [BoxFile(table, None)], [c.name for c in cameras], BoxOptions()
    survey = survey_boxes(files, known, options)
    times = dict.fromkeys(survey.cameras, FrameTimes("assumed frame rate", rate=as_rate(RATE)))
    boxes = read_boxes(files, survey, times, known, options, Boxes)
    return scene, Bearings.concat([found.bearings for found in detect_boxes(boxes, scene)])


def _files(folder: Path) -> list[Path]:
    """Table and calibration files of the folder cmc_detections; InputError if one of them is missing."""
    table, calibration = folder / TABLE, folder / CALIBRATION
    for path, there in ((table, table.is_file()), (calibration, calibration.is_dir())):
        if not there:
            raise InputError(f"{path}: not found; give the folder of cmc_detections", id="file-not-found")
    return [table, *sorted(p for p in calibration.iterdir() if p.is_file() and not p.name.startswith("."))]


class VirtualCrowd(NamedTuple):
    """Virtual people of a run, and what is left of the recording's detections.

    True paths of the people; mask of the bearings with a detection that they hide; all bearings, "not seen" where
    hidden; priors of the people by kind (none, known, kalman).
    """

    people: Truth
    gone: Bools  # rows of the bearings with a detection that is dropped
    left: Bearings  # all rows, "not seen" where the detection is dropped
    priors: dict[str, Occluders | None]  # by kind: none, known, kalman


def crowd_size(scene: Scene) -> int:
    """Number of virtual people for a scene: as dense as in the paper's lab, or `OCCLUDERS` without a room."""
    if scene.room is None:
        return OCCLUDERS
    x, y = scene.room.T
    area = 0.5 * abs(float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))))
    return min(MOST, max(1, round(OCCLUDERS * area / (LAB_SIZE[0] * LAB_SIZE[1] * INCH**2))))


def occluders_of(recorded: Recorded, seed: int) -> Truth:
    """Simulate the walks of virtual people during a recording, as dense and as wide as in the paper's lab."""
    t_ns, scene = recorded.positions.t_ns, recorded.scene
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
    """(n,) mask of detections with a line of sight to the target that a virtual person blocks ([Ercan] Fig. 3, A(x)).

    Args:
        recorded: n bearings, and the target's positions.
        people: positions of the virtual people.
        diameter: diameter of a person [m].
    """
    bearings, positions = recorded.bearings, recorded.positions
    times = np.unique(people.t_ns)
    crowd = np.column_stack([people.x, people.y]).reshape(len(times), -1, 2)
    now = np.clip(np.searchsorted(times, bearings.t_ns, side="right") - 1, 0, None)
    target = np.column_stack([positions.x, positions.y])[np.searchsorted(positions.t_ns, bearings.t_ns)]
    out = np.zeros(len(bearings), dtype=np.bool_)
    for camera in recorded.scene.cameras:
        rows = np.flatnonzero((bearings.sensor == camera.name) & bearings.seen)
        out[rows] = behind_objects(camera.ground, target[rows], crowd[now[rows]], diameter)
    return out


def crowd_of(recorded: Recorded, seed: int) -> VirtualCrowd:
    """Simulate virtual people with a seed, the same for all settings, and what they change in the recording."""
    people = occluders_of(recorded, seed)
    gone = hidden(recorded, people)
    priors = {
        "none": None,
        "known": Occluders.concat(list(known_positions([people]))),
        "kalman": Occluders.concat(list(virtual_priors([people], SIGMA, Q, seed))),
    }
    return VirtualCrowd(people, gone, unseen(recorded.bearings, gone), priors)


def trial(
    recorded: Recorded,
    crowd: VirtualCrowd,
    kind: str,
    cameras: Sequence[str],
    size: Size,
    seed: int,
    select: SelectConfig | None = None,
) -> dict[str, float]:
    """Track the target among virtual people and compare with its path.

    Args:
        recorded: recorded target.
        crowd: virtual people.
        kind: priors of the people: none, known or kalman; or `CLEAR` for no people.
        cameras: names of the cameras that are used.
        size: particles, and number of the recording's times that are used.
        seed: seed of the filter.
        select: policy of selection among the cameras; None: all are used.

    Returns:
        `rmse` [m], `rmse_occ` [m] (of the priors' means; NaN without priors), and `hidden`, the share of
        the detections that are dropped.
    """
    last = recorded.positions.t_ns[min(size.steps, len(recorded.positions)) - 1]
    table = recorded.bearings if kind == CLEAR else crowd.left
    used = (table.t_ns <= last) & np.isin(table.sensor, list(cameras))
    priors = crowd.priors.get(kind)
    tracking = TrackingTask(settings_of(recorded, size, kind), seed, sensors=frozenset(cameras), selection=select)
    parts = track([table.take(used)], recorded.scene, tracking, None if priors is None else [priors])
    rmse = _error(recorded, Tracks.concat([p.tracks for p in parts]))
    lost = crowd.gone[used & recorded.bearings.seen]
    share = float(np.mean(lost)) if kind != CLEAR and len(lost) else 0.0
    return {"rmse": rmse, "rmse_occ": rmse_of_priors(priors, crowd.people), "hidden": share}


def settings_of(recorded: Recorded, size: Size, kind: str) -> ApfConfig:
    """Settings of a trial's filter.

    Args:
        recorded: gives the target's start.
        size: number of particles.
        kind: kind of the priors; for `none` no detection probability is assumed.
    """
    return replace(
        ApfConfig.in_unit("m"),
        particles=size.particles,
        detection_probability=None if kind == "none" else DETECTION,
        false_alarm_probability=FALSE,
        occluder_diameter=DIAMETER,
        start=(*recorded.start.tolist(), START_SIGMA),
    )


def _error(recorded: Recorded, tracks: Tracks) -> float:
    """RMSE [m] of the tracks against the stand-in for the truth, without the first `SKIP` estimates.

    InputError if there are no others.
    """
    positions, tracks = recorded.positions, tracks.take(slice(SKIP, None))
    if not len(tracks):
        raise InputError(
            f"all estimates are among the first {SKIP}, which are skipped; give more steps or more cameras",
            id="insufficient-data",
        )
    row = np.searchsorted(positions.t_ns, tracks.t_ns)
    return float(np.sqrt(np.mean((tracks.x - positions.x[row]) ** 2 + (tracks.y - positions.y[row]) ** 2)))


def recorded_spec(source: RecordedFiles, size: Size, run: int, kind: str, cameras: list[str], **more: object) -> Spec:
    """Specification of a trial for `recorded_trial`, as plain values.

    Args:
        source: files of the recording.
        size: steps, particles, and the seed of all runs.
        run: number of the run.
        kind: kind of the priors: `none`, `kalman`, `known` or `clear`.
        cameras: names of the cameras that are used.
        **more: further values of the trial.
    """
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
        spec: `recording` (fields of `RecordedFiles`), `seed` (of the virtual people and of the
            filter), `steps`, `particles`, `kind`, `cameras`, and optional `select` (fields
            of `SelectConfig`).
    """
    source = RecordedFiles(**{**spec["recording"], "content": tuple(spec["recording"]["content"])})
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
def target_of(source: RecordedFiles) -> Recorded:
    """Recorded target of the files `source`; the last one is cached, as all trials of a process have the same."""
    return recorded_target(*read_source(source))


@functools.lru_cache(maxsize=2)
def _crowd(source: RecordedFiles, seed: int) -> VirtualCrowd:
    return crowd_of(target_of(source), seed)


NO_OCCLUSION = "no occlusion"
KINDS = {NONE: "none", PRIOR: "kalman", KNOWN: "known", NO_OCCLUSION: CLEAR}
ITEMS = ("fig14-recorded", "fig15-recorded")
RUNS = 20
EVERY = 1.0 / 7.5 * 5
"""Seconds between selections, as in the stand-in for the lab."""
Figures = dict[str, float]


def recorded_experiments(source: RecordedFiles, recorded: Recorded) -> tuple[Experiment, Experiment]:
    """Two experiments on a recorded target, as [Ercan] Figs. 14 and 15; the full form uses all of its times."""
    steps, names = len(recorded.positions), recorded.cameras
    quick = (2, min(60, steps))
    note = (
        f"Recorded detections, M = {crowd_size(recorded.scene)} virtual people; "
        "error against where the lines of sight of all cameras meet."
    )
    by_number = Experiment(
        item=ITEMS[0],
        title="Error and number of cameras, recorded detections",
        x_label="cameras",
        y_label="RMSE [m]",
        runs=RUNS,
        steps=steps,
        quick=quick,
        compute=partial(fig14, source, names),
        judge=judge14,
        note=note,
        trial=recorded_trial,
    )
    by_policy = replace(
        by_number,
        item=ITEMS[1],
        title="Policies of selection, recorded detections",
        x_label="selected cameras",
        compute=partial(fig15, source, names),
        judge=partial(judge_greedy, ITEMS[1]),
    )
    return by_number, by_policy


def fig14(source: RecordedFiles, names: Sequence[str], size: Size, execute: Execute) -> Table:
    """Table of the RMSE against the number of cameras, the root mean square over all sets of that number.

    `names` are those of the cameras of the recording `source`.
    """
    counts = range(2, len(names) + 1)
    sets = [list(some) for n in counts for some in combinations(names, n)]
    trials = [(run, name, cameras) for run in range(size.runs) for name in KINDS for cameras in sets]
    found = execute([recorded_spec(source, size, run, KINDS[name], cameras) for run, name, cameras in trials])
    runs: dict[tuple[int, str], list[list[Figures]]] = {
        (n, name): [[] for _ in range(size.runs)] for n in counts for name in KINDS
    }
    for (run, name, cameras), figures in zip(trials, found, strict=True):
        runs[len(cameras), name][run].append(figures)
    return [_row(name, n, [_over(figures) for figures in own]) for (n, name), own in runs.items()]


def _over(found: Sequence[Figures]) -> Figures:
    """Average the figures of one run over sets of cameras: root mean square of `rmse`, means of the others."""
    mean = {name: math.fsum(f[name] for f in found) / len(found) for name in ("rmse_occ", "hidden")}
    return {"rmse": math.sqrt(math.fsum(f["rmse"] ** 2 for f in found) / len(found)), **mean}


def fig15(source: RecordedFiles, names: Sequence[str], size: Size, execute: Execute) -> Table:
    """Table of the RMSE against the number of selected cameras, with priors and the weak-perspective model.

    `names` are those of the cameras of the recording `source`.
    """
    points = list(_selections(len(names)))
    specs = [
        recorded_spec(source, size, run, "kalman", list(names), select=select)
        for run in range(size.runs)
        for _, _, select in points
    ]
    found = execute(specs)
    return [_row(name, k, found[i :: len(points)]) for i, (name, k, _) in enumerate(points)]


def _selections(cameras: int) -> Iterator[tuple[str, float, Spec | None]]:
    policies = {GREEDY: "greedy", BRUTE: "brute-force", FIXED: "fixed", RANDOM: "random", CLOSEST: "closest"}
    for k in range(2, cameras):
        for name, policy in policies.items():
            yield (
                name,
                k,
                {"policy": policy, "n_cameras": k, "selection_interval": EVERY, "max_blind_scans": 0, "model": "weak"},
            )
    yield ALL, math.nan, None


def _row(name: str, x: float, runs: Sequence[Figures]) -> PaperRow:
    def mean(key: str) -> float:
        values = [r[key] for r in runs if not math.isnan(r[key])]
        return math.fsum(values) / len(values) if values else math.nan

    return PaperRow(name, x, tuple(r["rmse"] for r in runs), {"rmse_occ": mean("rmse_occ"), "hidden": mean("hidden")})


def judge14(table: Table) -> list[StatementVerdict]:
    """Verdicts on [Ercan] Fig. 14, for a recording: priors of occluders and more cameras lower the error."""
    return [*judge_priors(ITEMS[0], table), *judge_cameras(ITEMS[0], table)]
