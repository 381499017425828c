"""`occlog plan`: scene in; map, picture, page and rankings out."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from occlog.array_types import Floats
from occlog.console.summary import InWords
from occlog.console.text import as_bytes
from occlog.errors import InputError, UsageError, option
from occlog.io.files.provenance import Provenance
from occlog.io.open import load_scene, open_input
from occlog.records.declared.world import PlanMap
from occlog.records.losses import Loss
from occlog.records.scene import Camera, Scene
from occlog.records.tables import Tracks, Truth
from occlog.runner import Job, Tables
from occlog.settings import configure

from .config import PlanConfig
from .request import PlanRequest
from .sensing import Sensor
from .stage import (
    PlacementCandidate,
    PreparedPlan,
    add_greedily,
    along_walls,
    area_share_below,
    plan_map,
    prepare,
    rank_candidates,
    rank_removal,
    sensors_of,
    worst_cell,
)

PICTURES = (".png", ".svg")
PLACES = 16
"""Positions along the walls where no spacing is given."""


@dataclass(frozen=True)
class Rankings:
    """Rankings of sensors by the expected error over the floor; None: not requested.

    `candidates`: with one more sensor each; `added`: sensors added one after the other; `without`: with one less each.
    """

    candidates: tuple[PlacementCandidate, ...] | None
    added: tuple[PlacementCandidate, ...] | None
    without: tuple[PlacementCandidate, ...] | None


def run_plan(request: PlanRequest, job: Job) -> tuple[dict[str, object], tuple[Loss, ...]]:
    """Compute the plan, and write the requested outputs; return the summary and the losses of the file of paths."""
    _check(request)
    scene = load_scene(request.scene, None, request.scene)
    config = configure(PlanConfig.in_unit(scene.length_unit), request.settings)
    candidates = _candidates(request, scene)
    positions, losses = _places(request.paths, scene)
    planned = prepare(scene, config, request.seed, also=candidates, paths=positions)
    table = plan_map(planned)
    rankings = _rank(request, planned, candidates, job)
    parameters = asdict(config) | {
        "add": request.add or 0,
        "remove": request.remove,
        "along_walls": request.along_walls,
        "spacing": request.spacing,
    }
    provenance = job.provenance(parameters, losses, request.seed)
    summary = _summary(request, planned, table, rankings)
    warnings = caveats(scene, table)
    with job.tables(provenance, scene.length_unit) as tables:
        tables.write(output=table.sorted())
        _draw(request, planned, table, rankings, summary, warnings, provenance, tables)
    for warning in warnings:
        job.note(f"warning: {warning}")
    return summary | ({"warnings": warnings} if warnings else {}), losses


def _check(request: PlanRequest) -> None:
    """UsageError for contradictory options, or wrong suffixes of picture and page."""
    candidates, walls = option("candidates"), option("along_walls")
    if request.candidates is not None and request.along_walls is not None:
        raise UsageError(
            f"{candidates} and {walls} exclude each other; name all positions in one file", id="conflicting-options"
        )
    if request.candidates is None and request.along_walls is None and request.add is not None:
        raise UsageError(f"{option('add')} adds candidates; give {candidates} or {walls}", id="missing-option")
    if request.spacing is not None and request.along_walls is None:
        raise UsageError(f"{option('spacing')} is of positions along the walls; add {walls}", id="missing-option")
    if request.picture is not None and request.picture.suffix.lower() not in PICTURES:
        raise UsageError(f"{request.picture}: the picture is PNG or SVG; name it so")
    if request.report is not None and request.report.suffix.lower() not in (".html", ".htm"):
        raise UsageError(f"{request.report}: the report is HTML; name it so")


def _candidates(request: PlanRequest, scene: Scene) -> tuple[Sensor, ...]:
    """Return the candidate sensors of the request, from a file or along the walls; empty if none are requested.

    InputError if the scene has no room with walls, or the file another unit, no sensor, or a name of the scene.
    """
    if request.along_walls is not None:
        like = scene.camera(request.along_walls)
        if scene.room is None:
            raise InputError(
                f"{request.scene}: the scene has no room, so that there are no walls; add `room` to it",
                id="missing-value",
            )
        return along_walls(scene, like, request.spacing or _perimeter(scene.room) / PLACES)
    if request.candidates is None:
        return ()
    other = load_scene(request.candidates, None, request.candidates)
    if other.length_unit != scene.length_unit:
        raise InputError(
            f"{request.candidates}: lengths are in {other.length_unit}, but the scene's in {scene.length_unit}; "
            "use the same unit",
            id="unit-mismatch",
        )
    found = sensors_of(other)
    if not found:
        raise InputError(
            f"{request.candidates}: has no camera with a pose and no microphone array; list candidates",
            id="too-few-sensors",
        )
    own = {sensor.name for sensor in scene.sensors}
    if taken := next((sensor.name for sensor in found if sensor.name in own), None):
        raise InputError(
            f"{request.candidates}: {taken} is a sensor of the scene already; give it another name", id="duplicate-name"
        )
    return found


def _perimeter(room: Floats) -> float:
    return float(np.hypot(*(np.roll(room, -1, axis=0) - room).T).sum())


def _places(path: Path | None, scene: Scene) -> tuple[Floats | None, tuple[Loss, ...]]:
    """Return positions (P, 2) of people, in the scene's unit (None without a path), and the losses of their input."""
    if path is None:
        return None, ()
    opened = open_input(path, Tracks, Truth)
    if opened.length_unit not in (None, scene.length_unit):
        raise InputError(
            f"{path}: lengths are in {opened.length_unit}, but the scene's in {scene.length_unit}; use the same unit",
            id="unit-mismatch",
        )
    if opened.has(Truth):
        truth = opened.read(Truth)
        return np.column_stack([truth.x, truth.y]), opened.losses
    tracks = opened.read(Tracks)
    return np.column_stack([tracks.x, tracks.y]), opened.losses


def _rank(request: PlanRequest, planned: PreparedPlan, candidates: Sequence[Sensor], job: Job) -> Rankings:
    ranked = None
    if candidates:
        ranked = rank_candidates(planned, job.progress(candidates, "candidates", len(candidates)))
    return Rankings(
        candidates=None if ranked is None else tuple(ranked),
        added=tuple(add_greedily(planned, ranked, request.add)) if ranked is not None and request.add else None,
        without=tuple(rank_removal(planned)) if request.remove else None,
    )


def caveats(scene: Scene, table: PlanMap) -> list[str]:
    """Return warnings: cameras without a pose and readers, which are skipped, and a target rarely seen."""
    out = []
    unplaced = [camera.name for camera in scene.cameras if not camera.placed]
    if unplaced:
        out.append(f"{', '.join(unplaced)}: no pose, skipped; give position and yaw")
    if scene.readers:
        out.append("readers of tags are skipped: planning does not support their measurements")
    blind = float(table.weight @ table.unlocalised_share)
    if blind > 0.1:
        out.append(f"no sensor sees the target {blind:.0%} of the time; errors there are rough, add sensors")
    return out


def _summary(request: PlanRequest, planned: PreparedPlan, table: PlanMap, rankings: Rankings) -> dict[str, object]:
    unit, weight = planned.scene.length_unit, table.weight
    rmse = math.sqrt(float(weight @ table.rmse**2))
    worst = worst_cell(table)
    paths = {"map": request.output, "picture": request.picture, "report": request.report}
    summary: dict[str, object] = {name: str(path) for name, path in paths.items() if path is not None}
    summary |= {
        "sensors": len(sensors_of(planned.scene)),
        "people": planned.walked.people.shape[1] - 1,
        "cells": len(table),
        f"rmse_{unit}": rmse,
        f"rmse_error_{unit}": float(np.sqrt(np.sum((weight * table.rmse * table.rmse_error) ** 2))) / rmse,
        f"mean_{unit}": float(weight @ table.rmse),
        f"worst_{unit}": float(table.rmse[worst]),
        "worst_position": [float(table.x[worst]), float(table.y[worst])],
    }
    if planned.config.max_expected_error is not None:
        summary |= {
            f"within_{unit}": planned.config.max_expected_error,
            "share_within": area_share_below(table, planned.config.max_expected_error),
        }
    for name in ("seen_by_0", "seen_by_1", "seen_by_2", "unlocalised_share"):
        summary[name] = float(weight @ getattr(table, name))
    if rankings.candidates is not None:
        summary["candidates"] = _listed(rankings.candidates, unit)
    if rankings.added is not None:
        summary["added"] = _listed(rankings.added, unit)
    if rankings.without is not None:
        summary["without"] = _listed(rankings.without, unit)
    return summary


def _listed(ranking: Sequence[PlacementCandidate], unit: str) -> InWords:
    """Sensors of a ranking as records, with text of their names and errors for people."""
    words = ", ".join(f"{placed.sensor.name} {placed.rmse:.3g}" for placed in ranking)
    return InWords([placed_as_dict(placed, unit) for placed in ranking], words)


def placed_as_dict(placed: PlacementCandidate, unit: str) -> dict[str, object]:
    """Name, kind, position and yaw [deg] of a ranked sensor, and its RMSE over the floor, in `unit`, as a record."""
    sensor = placed.sensor
    return {
        "name": sensor.name,
        "kind": "camera" if isinstance(sensor, Camera) else "array",
        "position": [round(float(value), 4) for value in sensor.position],
        "yaw_deg": round(math.degrees(sensor.yaw), 2),
        f"rmse_{unit}": placed.rmse,
    }


def _draw(
    request: PlanRequest,
    planned: PreparedPlan,
    table: PlanMap,
    rankings: Rankings,
    summary: Mapping[str, object],
    warnings: Sequence[str],
    provenance: Provenance,
    tables: Tables,
) -> None:
    """Write the picture and the page of the plan to the outputs in `tables`, where they are requested.

    `summary` and `warnings` are those of the command.
    """
    if request.picture is None and request.report is None:
        return
    from .page import MapPicture, PageInput, map_picture, plan_page

    added = tuple(placed.sensor for placed in rankings.added or ())
    drawn = MapPicture(planned.scene, table, planned.cells.size, added, planned.config.max_expected_error)
    if request.picture is not None:
        tables.write_bytes("picture", map_picture(drawn, request.picture.suffix.lower()))
    if request.report is not None:
        page = plan_page(PageInput(drawn, summary, tuple(warnings), provenance.as_dict()))
        tables.write_bytes("report", as_bytes(page))
