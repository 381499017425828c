"""Data of the page's script: the room, the sensors and the time steps of a run, as JSON."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from occlog.array_types import NS, Floats
from occlog.core.metrics.errors import CHI2_95_2D
from occlog.examine.viewers.drawings.people import HEIGHT, WIDTH
from occlog.records.scene import Camera, MicrophoneArray, Scene
from occlog.report.content.model import ReportInput
from occlog.report.plots.floorplan import near_scene, plan_limits, view_area
from occlog.settings import METRES

from .steps import MISSING, ReplaySteps, Words, packed
from .thumbnails import Thumbnails

LARGEST = 2.5
"""Widths and heights are reported up to this [m]."""
MAX_EVENTS = 400
MAX_BOXES = 40
"""Targets that can be switched off one by one."""
PEAKS = 5
MIN_PEAK_SEPARATION = 0.05
"""Peaks of the error have at least this share of the time between them."""


Layer = tuple[str, str, bool]
"""A layer: its name, its label, and whether it is visible initially."""


@dataclass(frozen=True)
class Peak:
    """A large error, to which the replay can be moved.

    Attributes:
        target: identity of the target.
        kind: phrase that names the kind of error.
        error: size of the error, in the unit of lengths.
        seconds: time [s since the start].
    """

    target: int
    kind: str
    error: float
    seconds: float


@dataclass(frozen=True)
class Replay:
    """Data of the page's replay of a run.

    Attributes:
        json: input of the script, safe inside a `<script>` element.
        words: sentences about what is shown and what is skipped.
        targets: identities that can be switched off, with the index of their colour.
        layers: layers that can be switched off: name, label, initial visibility.
        peaks: the largest errors, the largest first.
        cameras: names of the cameras that have images.
        plan: whether there is a floor plan.
        errors: whether errors of the targets are known.
        existence: whether existence probabilities are known.
    """

    json: str
    words: str
    targets: list[tuple[int, int]]
    layers: list[Layer]
    peaks: list[Peak]
    cameras: list[str]
    plan: bool = True
    errors: bool = False
    existence: bool = False


def replay(data: ReportInput, images: Thumbnails | None = None) -> Replay | None:
    """Return the data of the replay of a run; None with fewer than two time steps."""
    limits = plan_limits(data)
    # In images it is seen that there is no target
    steps = ReplaySteps(data, limits, imaged=images.times) if data.in_images and images else ReplaySteps(data, limits)
    if len(steps.kept) < 2:
        return None
    tables, every, layers = plan_values(data, steps)
    values: dict[str, Any] = {
        "second": data.time.ns_per_unit / NS,
        "times": packed("f8", steps.seconds),
        **tables,
        "events": _events(data),
        "images": [] if images is None else images.packed(data.time.start_ns),
    }
    return Replay(
        safe_json(values),
        _words(steps, every, images),
        [] if data.in_images else [(target, k) for k, target in enumerate(data.targets[:MAX_BOXES])],
        [] if data.in_images else layers,
        _peaks(data),
        [] if images is None else list(images.cameras),
        plan=not data.in_images,
        errors=values["compared"] and not data.in_images,
        existence=values["existence"],
    )


def plan_values(data: ReportInput, steps: ReplaySteps) -> tuple[dict[str, Any], int, list[Layer]]:
    """Return the plan's data at each time step, the interval of the steps with lines of sight, and the layers."""
    sensors = [] if data.scene is None else _sensors(near_scene(data.scene)[0], steps.limits)
    metres = METRES.get(data.unit, 1.0)
    seen, doubts = Words(), Words()
    size, sigma = LARGEST / metres / 255, _sigma_step(data, steps)
    sight, sight_every = steps.sight([s["name"] for s in sensors])
    priors, priors_every = steps.priors()
    tables = {"tracks": steps.tracks(seen, doubts, size, sigma), "truth": steps.truth()}
    values: dict[str, Any] = {
        "unit": data.unit,
        "limits": _rounded(steps.limits),
        "room": None if data.scene is None or data.scene.room is None else _rounded(data.scene.room),
        "occluders": [] if data.scene is None else [_rounded(o.polygon) for o in data.scene.occluders],
        "sensors": sensors,
        "targets": list(data.targets),
        "compared": bool(tables["truth"]) and (steps.same or bool(steps.pairs)),
        "existence": data.people_tracks is not None and not data.in_images,
        "ellipse": CHI2_95_2D,
        "step": steps.step,
        "sigma": sigma,
        "size": size,
        "body": [WIDTH / metres, HEIGHT / metres],
        **tables,
        "sight": sight,
        "sightEvery": sight_every,
        "hulls": priors,
        "priorsEvery": priors_every,
        "words": {"seen": seen.all, "doubt": doubts.all},
    }
    return values, sight_every if sight else 1, _layers(tables["truth"], sight, priors, sensors)


def safe_json(values: object) -> str:
    """Return `values` as JSON that is safe inside an HTML script element."""
    text = json.dumps(values, ensure_ascii=True, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _rounded(points: Floats) -> list[Any]:
    return list(np.round(points, 6).tolist())


def _sigma_step(data: ReportInput, steps: ReplaySteps) -> float:
    """Return the quantisation step of standard deviations [length], such that the largest fits 16 bits.

    The largest is limited to twice the size of the plan.
    """
    most = 2.0 * float((steps.limits[1] - steps.limits[0]).max())
    tracks = data.tracks
    if tracks is not None and len(tracks):
        variance = np.concatenate([tracks.cov_xx, tracks.cov_yy])
        largest = float(np.nanmax(np.sqrt(np.maximum(variance, 0)), initial=0.0))
        most = min(most, largest) if largest > 0 else most
    return most / (MISSING - 1)


def _sensors(scene: Scene, limits: Floats) -> list[dict[str, Any]]:
    """Return position, axis and field of view of each sensor with a pose, for the page's script.

    `limits`: (2, 2) lower and upper corner of the plan.
    """
    far = float(np.hypot(*(limits[1] - limits[0])))
    placed: list[Camera | MicrophoneArray] = [*(c for c in scene.cameras if c.placed), *scene.arrays]
    out = []
    for sensor in placed:
        x, y, z = (round(float(v), 6) for v in sensor.position)
        one: dict[str, Any] = {"name": sensor.name, "x": x, "y": y, "z": z, "kind": "array", "view": None}
        if isinstance(sensor, Camera):
            view = _rounded(view_area(scene, sensor, far))
            reach = min(sensor.range, far)
            one |= {"kind": "camera", "yaw": sensor.yaw, "fov": sensor.fov, "range": reach, "view": view}
        out.append(one)
    return out


def _events(data: ReportInput) -> list[list[Any]]:
    """Return times [s since the start] and kinds of track events, evenly thinned to `MAX_EVENTS`."""
    events = data.events
    if events is None or not len(events):
        return []
    rows = np.unique(np.linspace(0, len(events) - 1, min(len(events), MAX_EVENTS)).round().astype(int))
    seconds = (events.t_ns - data.time.start_ns) / NS
    return [[round(float(seconds[k]), 6), str(events.kind[k])] for k in rows]


def _peaks(data: ReportInput) -> list[Peak]:
    """Return the `PEAKS` largest errors, each separated in time from a larger one of the same target."""
    errors, out = data.errors, list[Peak]()
    if errors is None or not len(errors):
        return out
    seconds = (errors.t_ns - data.time.start_ns) / NS
    separation = MIN_PEAK_SEPARATION * max(float(np.ptp(seconds)), 1e-9)
    for k in np.argsort(-errors.error, kind="stable")[:20_000]:
        target = int(errors.target_id[k])
        if all(peak.target != target or abs(peak.seconds - seconds[k]) > separation for peak in out):
            out.append(Peak(target, data.whose_errors(target), float(errors.error[k]), round(float(seconds[k]), 6)))
            if len(out) == PEAKS:
                break
    return out


def _layers(truth: object, sight: object, priors: object, sensors: list[dict[str, Any]]) -> list[Layer]:
    cameras = any(s["kind"] == "camera" for s in sensors)
    every = [
        ("names", "names", True, True),
        ("ellipses", "ellipses (95 %)", True, True),
        ("truth", "truth", True, bool(truth)),
        ("sight", "lines of sight", True, bool(sight)),
        ("views", "fields of view", False, cameras),
        ("shadows", "shadows of people", cameras, cameras),
        ("priors", "occluders as the tracker knew them", True, bool(priors)),
    ]
    return [(name, words, on) for name, words, on, there in every if there]


def _words(steps: ReplaySteps, sight_every: int, images: Thumbnails | None) -> str:
    count, all_of = len(steps.data.figures.times), steps.count
    reported = [
        f"{count:,} of {all_of:,} time steps: every {steps.every}-th." if steps.every > 1 else f"{count:,} time steps."
    ]
    if sight_every > 1:
        reported.append(f"Lines of sight are those of every {sight_every}-th of them.")
    if steps.data.in_images:
        reported.append("Positions are those of the centres of targets in the image, to the right and down.")
        dashed = "without a box in the frame" if steps.data.boxes_stated else "on which its neighbours alone act"
        reported += [f"A dashed outline is of a target {dashed}."] if images is not None else []
    else:
        reported.append("A dashed ring is a target that no sensor sees, or of which something is uncertain.")
    reported += ["A cross is where one truly is."] if steps.truth() else []
    reported.append(f"Positions are rounded to {steps.step:.1g} {steps.data.unit}.")
    if not steps.same and not steps.data.in_images:
        reported.append("Identities are the tracker's own, not those of the truth.")
        reported += ["Errors are from the true target that a track is paired with."] if steps.pairs else []
    if images is not None:
        reported.append(images.words)
    return " ".join(filter(None, reported))
