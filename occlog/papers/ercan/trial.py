"""Trials of the auxiliary particle filter, and the rows of a table made of them.

The rooms of [Ercan] Secs. 6 and 7 as scene files.

The scan of the paper has no figures: the positions of cameras and occluders are this project's reference.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from occlog.io.formats.scenes.scene import scene_from_yaml
from occlog.papers.verdicts import (
    EXTRAS,
    Execute,
    PaperRow,
    Size,
    StatementVerdict,
    Table,
    find,
    matched,
    mean_of,
    neighbours,
    pairs,
    sample,
    series,
    stated,
)
from occlog.pipeline.sweep.trial import Spec, Values
from occlog.settings import configure
from occlog.simulate.config import WorldConfig
from occlog.simulate.stage import simulate_truth

WORST = "no tracking (middle of the room)"
NONE, KNOWN, PRIOR = "no priors", "positions known", "priors"
EACH = ("rmse_occ",)
"""Figures of trials that are judged, too."""


class TrialPoint(NamedTuple):
    """One point of a figure: name of the series, x, and the specification of its trial without run number."""

    series: str
    x: float
    spec: Spec


def trial(
    scene: str,
    size: Size,
    simulate: Values,
    priors: Values,
    *,
    cameras: Sequence[str] | None = None,
    **more: Any,
) -> Spec:
    """Specification of a trial of `occlog.pipeline.sweep.trial.run_trial`.

    Args:
        scene: scene file as text.
        size: steps, particles and seed.
        simulate: settings of the simulated world, perhaps with another number of steps.
        priors: kind and settings of the occluders' priors.
        cameras: names of the cameras that are used; None: all.
        more: further entries; those of `track` are settings of the filter.
    """
    spec = {
        "scene": scene,
        "seed": size.seed,
        "simulate": {"steps": size.steps, **simulate},
        "priors": dict(priors),
        "track": {"method": "apf", "particles": size.particles, "occlusion_tempering": 1.0, **more.pop("track", {})},
        **more,
    }
    return spec if cameras is None else {**spec, "cameras": list(cameras)}


def run_points(points: Sequence[TrialPoint], size: Size, execute: Execute) -> Table:
    """Run the trials of all points, and return a row for every point, with the RMSE of each run.

    Runs of one number have the same world at all points.
    """
    specs = [{**p.spec, "run": run} for run in range(size.runs) for p in points]
    results = execute(specs)
    return [_row(p, results[i :: len(points)]) for i, p in enumerate(points)]


def _row(point: TrialPoint, results: Sequence[Mapping[str, float]]) -> PaperRow:
    extra = {}
    for name in EXTRAS:
        values = [r[name] for r in results if name in r and not math.isnan(r[name])]
        extra[name] = math.fsum(values) / len(values) if values else math.nan
    each = {name: tuple(r[name] for r in results) for name in EACH if all(name in r for r in results)}
    return PaperRow(point.series, point.x, tuple(r["rmse"] for r in results), extra, each=each)


def worst_case(scene_text: str, simulate: Values, size: Size) -> PaperRow:
    """RMSE_max of [Ercan] Sec. 6.1 as a row: the error of the middle of the room's bounding box as the estimate.

    The targets are drawn as those of the trials, without moving occluders.

    Args:
        scene_text: YAML text of the scene.
        simulate: settings of the world.
        size: runs, steps and seed.
    """
    scene = scene_from_yaml(scene_text, "scene")
    few = {**simulate, "steps": size.steps, "occluders": 0}
    config: WorldConfig = configure(WorldConfig.in_unit(scene.length_unit), few)
    middle = 0.5 * (scene.region.min(axis=0) + scene.region.max(axis=0))
    values = []
    for run in range(size.runs):
        total, count = 0.0, 0
        for chunk in simulate_truth(scene, config, size.seed + run):
            total += float(((chunk.x - middle[0]) ** 2 + (chunk.y - middle[1]) ** 2).sum())
            count += len(chunk)
        values.append(math.sqrt(total / count))
    return PaperRow(WORST, math.nan, tuple(values))


def judge_worst_case(table: Table, item: str, paper: float) -> list[StatementVerdict]:
    """Verdict on the error without tracking (row of `worst_case`) against that of the paper, as a list.

    Empty if the table has no such row. `item` is the figure, which begins the id; `paper` the printed number.
    """
    row = find(table, WORST)
    if row is None:
        return []
    statement = "Error without tracking, of the middle of the room."
    return [stated(f"{item}-rmse-max", statement, paper, mean_of(row))]


def judge_cameras(item: str, table: Table) -> list[StatementVerdict]:
    """Verdicts on whether every further camera lowers the error, for known positions, priors and neither."""
    return [
        pairs(
            f"{item}-cameras-{key}", f"Every further camera lowers the error ({name}).", neighbours(series(table, name))
        )
        for key, name in (("known", KNOWN), ("priors", PRIOR), ("none", NONE))
    ]


def judge_priors(item: str, table: Table) -> list[StatementVerdict]:
    """Verdicts on whether known positions of occluders have a lower error than priors, and these than none."""
    return [
        pairs(f"{item}-known", "Known positions give a lower error than priors.", matched(table, KNOWN, PRIOR)),
        pairs(f"{item}-priors", "Priors give a lower error than none.", matched(table, PRIOR, NONE)),
    ]


def priors_error(item: str, rows: Sequence[PaperRow], paper: float) -> list[StatementVerdict]:
    """Verdict on the error of the priors, the mean over the rows with priors, run by run, as a list.

    Empty without such rows. `item` is the figure, which begins the id; `paper` the printed number.
    """
    given = [own for r in rows if (own := r.each.get("rmse_occ")) and min(own) > 0.0]
    if not given:
        return []
    of_runs = sample([math.fsum(own) / len(own) for own in zip(*given, strict=True)])
    statement = "Error of the occluders' priors (set by the noise of the virtual measurements)."
    return [stated(f"{item}-rmse-occ", statement, paper, of_runs)]


def kalman(sigma: float, q: float = 1.2) -> Values:
    """Values of a trial that select priors by a Kalman filter on virtual measurements, or known positions.

    Args:
        sigma: standard deviation of the measurements; 0: known positions.
        q: process noise of the velocity, accumulated over 1 s.
    """
    return (
        {"kind": "kalman", "measurement_noise": sigma, "process_noise_velocity": q} if sigma > 0 else {"kind": "known"}
    )


Place = tuple[float, float, float]
"""Position x, y and yaw [deg] of a camera."""

SQUARE = [
    (0, 0, 45),
    (50, 0, 90),
    (100, 0, 135),
    (100, 50, 180),
    (100, 100, 225),
    (50, 100, 270),
    (0, 100, 315),
    (0, 50, 0),
]
L_SHAPE = [
    (0, 0, 45),
    (80, 0, 90),
    (160, 0, 135),
    (160, 26.5, 180),
    (160, 53, 225),
    (106.5, 53, 270),
    (53, 53, 225),
    (53, 106.5, 180),
    (53, 160, 225),
    (26.5, 160, 270),
    (0, 160, 315),
    (0, 80, 0),
]
SQUARE_ORDER = (1, 7, 5, 3, 2, 4, 6, 8)
L_ORDER = (1, 4, 7, 10, 8, 12, 3, 5, 2, 6, 11, 9)
LAB_ORDER = (1, 13, 9, 5, 3, 8, 11, 16, 6)
LAB_SIZE = (264.0, 228.0)
"""22 ft x 19 ft, in inches."""


def names(numbers: Sequence[int]) -> list[str]:
    """Names `cam1`, `cam2`, ... of the cameras with these numbers."""
    return [f"cam{n}" for n in numbers]


def square_room(*, pillar: bool) -> str:
    """YAML text of the room of [Ercan] Fig. 5: 100 x 100, eight cameras, with its static occluder if `pillar`."""
    box = [(40, 40), (60, 40), (60, 60), (40, 60)] if pillar else None
    return _scene("unit", [(0, 0), (100, 0), (100, 100), (0, 100)], box, cameras=SQUARE, focal=70.0, fov=90.0, yaw=0.01)


def l_room() -> str:
    """YAML text of the L-shaped room of [Ercan] Fig. 11: 160 x 160 without [53, 160]^2, twelve cameras."""
    room = [(0, 0), (160, 0), (160, 53), (53, 53), (53, 160), (0, 160)]
    return _scene("unit", room, None, cameras=L_SHAPE, focal=70.0, fov=90.0, yaw=0.01)


def lab() -> str:
    """YAML text of a stand-in for the lab of [Ercan] Fig. 13, in inches.

    Sixteen cameras of 47 degrees counter-clockwise along the walls, four to a wall from
    corner 1 on, which point at the middle of the room; images 640 px wide; one static
    occluder of 2 ft x 2 ft next to the middle.
    """
    w, h = LAB_SIZE
    corners = [(0.0, 0.0), (w, 0.0), (w, h), (0.0, h)]
    cameras: list[Place] = []
    for n in range(16):
        (ax, ay), (bx, by) = corners[n // 4], corners[(n // 4 + 1) % 4]
        x, y = ax + (bx - ax) * (n % 4) / 4, ay + (by - ay) * (n % 4) / 4
        cameras.append((x, y, math.degrees(math.atan2(0.5 * h - y, 0.5 * w - x))))
    box = [(150, 96), (174, 96), (174, 120), (150, 120)]
    focal = 320.0 / math.tan(math.radians(23.5))
    return _scene("in", corners, box, cameras=cameras, focal=focal, fov=47.0, yaw=0.068)


def _scene(
    unit: str,
    room: Sequence[tuple[float, float]],
    box: Sequence[tuple[float, float]] | None,
    cameras: Sequence[Place],
    focal: float,
    fov: float,
    yaw: float,
) -> str:
    """YAML text of a scene; every camera has the noise sigma_pos 1 and sigma_read 2 px.

    Args:
        unit: length unit.
        room: corners of the room.
        box: corners of a static occluder; None: none.
        cameras: x, y and yaw [deg] of each camera.
        focal: focal length [px].
        fov: field of view [deg].
        yaw: standard deviation of the yaw [rad].
    """
    lines = ["occlog_scene: 1", f"length_unit: {unit}", f"room: {_points(room)}"]
    if box is not None:
        lines += ["static_occluders:", f"- {{name: pillar, polygon: {_points(box)}}}"]
    lines.append("cameras:")
    for n, (x, y, direction) in enumerate(cameras, start=1):
        lines.append(
            f"- {{name: cam{n}, position: [{x:g}, {y:g}], yaw_deg: {direction:.6g}, focal_px: {focal:.6g}, "
            f"fov_deg: {fov:g}, noise: {{position: 1, yaw: {yaw:g}, measurement_noise_px: 2}}}}"
        )
    return "\n".join(lines) + "\n"


def _points(points: Sequence[tuple[float, float]]) -> str:
    return "[" + ", ".join(f"[{x:g}, {y:g}]" for x, y in points) + "]"
