"""[Ercan] Sec. 7 on recorded detections: virtual occluders are thrown over what cameras reported.

A recording without ground truth has no true target.  The track that all cameras give
together, without any virtual occluder, stands in for it.  Of each camera's detections the
one nearest to that track becomes the target's; the others are left out.  Virtual people
then walk through the room, and a camera whose sight line to the target one of them crosses
is made to report that it did not see it.  What is measured is what the occlusions cost.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..columns import Bools, Floats, Ints
from ..core.sight import behind_objects
from ..errors import InputError
from ..records import UNLABELLED, Bearings, Occluders, Tracks, Truth
from ..scene import Camera, Scene
from ..stages.occluders import known_positions
from ..stages.priors_kalman import virtual_priors
from ..stages.simulate import WorldConfig, simulate_truth, world_config
from ..stages.track import track
from ..sweep.trial import rmse_of_priors
from ..trackers.apf_config import apf_defaults
from ..trackers.select import SelectConfig
from .model import Size

TARGET = 0
GATE = 3.0
"""Standard deviations within which the detection nearest to the stand-in for the truth is the target's."""
OCCLUDERS = 20
INCH = 0.0254
DIAMETER = 12 * INCH
SIGMA, Q = 12.8 * INCH, 24 * INCH
"""Virtual measurements of the occluders, as in the stand-in for the lab."""
DETECTION, FALSE = 0.9, 0.05
"""Probabilities that the filter is told, in all settings: recorded detectors miss and are wrong."""
START_SIGMA = 0.5
"""The filters are told the first place so well; with two cameras among people they would search for long."""
SKIP = 10
"""Estimates left out at the start."""


@dataclass(frozen=True)
class Recorded:
    """A recorded target: what each camera said of it, and where all of them together say that it was."""

    scene: Scene
    bearings: Bearings  # of the target alone, labelled
    places: Truth  # the stand-in for the truth, at every time of the bearings
    start: Floats  # (2,) its first place

    @property
    def cameras(self) -> tuple[str, ...]:
        """Cameras that saw the target at least once, in the order of the scene."""
        seen = set(self.bearings.sensor[self.bearings.seen].tolist())
        return tuple(c.name for c in self.scene.cameras if c.name in seen)


def recorded_target(scene: Scene, bearings: Bearings) -> Recorded:
    """The target of a recording in metres; InputError if there is none, or no two cameras that see it.

    Args:
        scene: cameras with poses.
        bearings: labelled or not; of labelled ones those of the first target count.
    """
    if scene.length_unit != "m":
        raise InputError(f"the recording is in {scene.length_unit}, the experiment wants metres")
    config = replace(apf_defaults("m"), particles=4000)
    tracks = Tracks.concat([p.tracks for p in track([bearings], scene, config, 0)])
    if len(tracks) <= SKIP + 1:
        raise InputError(f"{len(tracks)} times with detections, want more than {SKIP + 1}")
    target = tracks.target_id[0]
    tracks = tracks.take(tracks.target_id == target)
    own = np.isin(bearings.target_id, (UNLABELLED, target)) & np.isin(bearings.t_ns, tracks.t_ns)
    mine = assign(scene, bearings.take(own), tracks)
    names = {c.name for c in scene.cameras}
    found = set(mine.sensor[mine.seen].tolist()) & names
    if len(found) < 2:
        raise InputError(f"{len(found)} cameras saw the target, want at least 2")
    n = len(tracks)
    places = Truth.of(
        t_ns=tracks.t_ns, target_id=np.full(n, TARGET), role=["target"] * n, x=tracks.x, y=tracks.y,
        z=np.full(n, np.nan),
    )  # fmt: skip
    return Recorded(scene, mine, places, np.array([tracks.x[0], tracks.y[0]]))


def assign(scene: Scene, bearings: Bearings, tracks: Tracks) -> Bearings:
    """One row of every camera and frame: its detection nearest to a track, or "not seen" where none is near."""
    place = np.searchsorted(tracks.t_ns, bearings.t_ns)
    away = np.full(len(bearings), np.inf)
    for camera in scene.cameras:
        rows = np.flatnonzero((bearings.sensor == camera.name) & bearings.seen)
        away[rows] = _distance(camera, bearings, rows, tracks, place[rows])
    kept = []
    for sensor in sorted({c.name for c in scene.cameras} & set(bearings.sensor.tolist())):  # arrays hear, not see
        rows = np.flatnonzero(bearings.sensor == sensor)
        for group in np.split(rows, np.flatnonzero(np.diff(bearings.t_ns[rows])) + 1):
            kept.append(int(group[np.argmin(away[group])]))
    some = bearings.take(np.array(sorted(kept)))
    labelled = replace(some, target_id=np.full(len(some), TARGET, dtype=np.int32))
    return unseen(labelled, away[sorted(kept)] > GATE)


def _distance(camera: Camera, bearings: Bearings, rows: Ints, tracks: Tracks, place: Ints) -> Floats:
    """(n,) difference of bearings from those of a track, in standard deviations of both together."""
    dx, dy = tracks.x[place] - camera.ground[0], tracks.y[place] - camera.ground[1]
    r2 = dx**2 + dy**2
    across = dy**2 * tracks.cov_xx[place] - 2 * dx * dy * tracks.cov_xy[place] + dx**2 * tracks.cov_yy[place]
    spread = across / r2**2 + bearings.sigma[rows] ** 2
    apart = bearings.bearing[rows] - np.arctan2(dy, dx)
    return np.asarray(np.abs(np.angle(np.exp(1j * apart))) / np.sqrt(spread))


def unseen(bearings: Bearings, rows: Bools) -> Bearings:
    """The bearings, with "not seen" in some rows."""
    nothing = {
        n: np.where(rows, np.nan, getattr(bearings, n)) for n in ("bearing", "sigma", "u_px", "sigma_px", "score")
    }
    return replace(bearings, seen=bearings.seen & ~rows, **nothing)


def occluders_of(recorded: Recorded, seed: int) -> Truth:
    """Virtual people, as many and as thick as in the paper's lab, from the recording's first time to its last."""
    t_ns, scene = recorded.places.t_ns, recorded.scene
    step_ns = int(np.median(np.diff(t_ns)))
    config: WorldConfig = replace(
        world_config("m"), steps=int((t_ns[-1] - t_ns[0]) // step_ns) + 2, step_s=step_ns * 1e-9, targets=0,
        occluders=OCCLUDERS, diameter=DIAMETER, start_ns=int(t_ns[0]),
    )  # fmt: skip
    return Truth.concat(list(simulate_truth(scene, config, seed)))


def hidden(recorded: Recorded, people: Truth, diameter: float = DIAMETER) -> Bools:
    """(n,) rows of the bearings whose sight line to the target somebody crosses: he is in A(x) of [Ercan] Fig. 3."""
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


def priors_of(people: Truth, kind: str, seed: int) -> Occluders | None:
    """What is known of the virtual people; `kind` is none, known or kalman."""
    if kind == "none":
        return None
    if kind == "known":
        return Occluders.concat(list(known_positions([people])))
    return Occluders.concat(list(virtual_priors([people], SIGMA, Q, seed)))


def trial(
    recorded: Recorded, seed: int, kind: str, cameras: Sequence[str], size: Size, select: SelectConfig | None = None
) -> dict[str, float]:
    """Error of one track among the virtual people of a seed, and what share of detections they took away.

    Args:
        recorded: the target.
        seed: of the virtual people, and of the filter.
        kind: what is known of them: none, known or kalman.
        cameras: names of those to use.
        size: particles, and how many times of the recording are used.
        select: how to select among the cameras.
    """
    people = occluders_of(recorded, seed)
    gone = hidden(recorded, people)
    left = unseen(recorded.bearings, gone)
    last = recorded.places.t_ns[min(size.steps, len(recorded.places)) - 1]
    priors = priors_of(people, kind, seed)
    config = replace(
        apf_defaults("m"), particles=size.particles, detection=DETECTION, false=FALSE, occluder_diameter=DIAMETER,
        start=(*recorded.start.tolist(), START_SIGMA),
    )  # fmt: skip
    parts = track(
        [left.take(left.t_ns <= last)], recorded.scene, config, seed, sensors=frozenset(cameras),
        occluders=None if priors is None else [priors], selection=select,
    )  # fmt: skip
    tracks = Tracks.concat([p.tracks for p in parts])
    row = np.searchsorted(recorded.places.t_ns, tracks.t_ns)
    away = np.hypot(tracks.x - recorded.places.x[row], tracks.y - recorded.places.y[row])[SKIP:]
    own = np.isin(recorded.bearings.sensor, list(cameras)) & recorded.bearings.seen
    return {
        "rmse": float(np.sqrt(np.mean(away**2))),
        "rmse_occ": rmse_of_priors(priors, people),
        "hidden": float(np.mean(gone[own])) if own.any() else math.nan,
    }
