"""[Lee] Sec. 3.2.2: errors of the parallel projection model and of triangulation, of positions and of tracks."""

from __future__ import annotations

import math

import numpy as np

from occlog.papers import verdicts as v
from occlog.papers.verdicts import Execute, Experiment, PaperRow, Size, StatementVerdict, Table
from occlog.pipeline.sweep.trial import Spec

from .environments import environment
from .projected_places import LINES, PROJECTIONS, crossed, projected, sights_of
from .trial import cooperation_spec, cooperation_trial

REFERENCE = "reference"
SPREADS = (1.0, 3.0, 6.0)
"""Standard deviations of a reference per axis [m]; without cameras the filter's error is some 6 m."""
DRAWS, RADIUS = 500, 22.9
"""Objects of a run, and how far from the array they are at most [m]: its range."""
ONCE, DEEP, THRICE, OFTEN = PROJECTIONS
TRACK = "track"


def projection_trial(spec: Spec) -> dict[str, float]:
    """Run a trial of tracks by `cooperation_trial`, or with `what` = "places" one of positions alone.

    Returns:
        Of positions: the median distance to the truth [m] as `WAY_SPREAD`, for every way to find them and spread of the
        references.
    """
    if spec.get("what") != "places":
        return cooperation_trial(spec)
    scene = environment("pair", 0, 0).scene
    rng = np.random.default_rng(np.random.SeedSequence(spec["seed"], spawn_key=(spec["run"], 2009, 322)))
    # Objects that are even over the array's range, and what both cameras see of them
    radius, angle = RADIUS * np.sqrt(rng.random(DRAWS)), rng.uniform(-math.pi, math.pi, DRAWS)
    xy = scene.arrays[0].position[:2] + radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    sigma = scene.cameras[0].sigma_read_px / float(scene.cameras[0].focal_px[0])
    away = xy[:, None] - np.array([c.ground for c in scene.cameras])
    bearing = np.arctan2(away[..., 1], away[..., 0]) + sigma * rng.standard_normal((DRAWS, 2))
    sights, normals, out = sights_of(scene.cameras, bearing, sigma), rng.standard_normal((DRAWS, 2)), {}
    for spread in SPREADS:
        reference = xy + spread * normals
        projections = {way: projected(reference, sights, p) for way, p in PROJECTIONS.items()}
        projections |= {LINES: crossed(sights), REFERENCE: (reference, np.ones(DRAWS, dtype=np.bool_))}
        for way, (found, good) in projections.items():
            error = np.hypot(*(found - xy).T)
            out[f"{way}_{spread:g}"] = float(np.median(np.where(good, error, np.inf)))
    return out


def errors(size: Size, execute: Execute) -> Table:
    """Table of median position errors [m] by the error of initial positions, and of RMSE by the printed triggers."""
    runs = range(size.runs)
    position_rows = execute([{"what": "places", "paper": "lee322", "seed": size.seed, "run": r} for r in runs])
    rows = [
        PaperRow(way, spread, tuple(p[f"{way}_{spread:g}"] for p in position_rows))
        for way in (REFERENCE, *PROJECTIONS, LINES)
        for spread in SPREADS
    ]
    for way, own in v.run_trials(
        (*PROJECTIONS, LINES),
        size,
        execute,
        lambda way, run: cooperation_spec(
            size, run, "pair", "thesis", projection="" if way == LINES else way, cooperate="printed"
        ),
    ):
        extra = {"frames": math.fsum(r["frames"] for r in own) / size.runs}
        rows.append(PaperRow(f"{TRACK}, {way}", math.nan, v.values_of(own, "rmse"), extra, plotted=False))
    return rows


def judge_errors(table: Table) -> list[StatementVerdict]:
    """Verdicts on what the thesis states about parallel projection, and on its comparison with lines of sight."""
    pairs = [
        ("sec3.2.2-improves", "Eq. 5.39 improves the reference: median lower by [m].", ONCE, REFERENCE),
        ("sec3.2.2-depth", "Eq. 5.40 is better than Eq. 5.39: median lower by [m].", DEEP, ONCE),
        ("sec3.2.2-lines", "Crossed lines of sight are better than Eq. 5.39: median lower by [m].", LINES, ONCE),
        ("sec3.2.2-passes", "Three passes of Eq. 5.39 are better than one: median lower by [m].", THRICE, ONCE),
    ]
    out = [v.pairs(key, statement, v.matched(table, low, high)) for key, statement, low, high in pairs]
    statement = "Ten passes of Eq. 5.39 are as good as crossed lines of sight."
    out.append(v.close("sec3.2.2-limit", statement, v.matched(table, OFTEN, LINES)))
    lines = v.row_of(table, f"{TRACK}, {LINES}")
    for key, way in (("once", ONCE), ("often", OFTEN)):
        row = v.row_of(table, f"{TRACK}, {way}")
        statement = (
            f"Tracks with the printed triggers are better with lines of sight than with {way}: RMSE lower by [m]."
        )
        out.append(v.pairs(f"sec3.2.2-track-{key}", statement, [(lines, row)]))
    return out


SEC3_2_2 = Experiment(
    item="sec3.2.2",
    title="Positions by parallel projection and by lines of sight",
    x_label="standard deviation of the reference per axis [m]",
    y_label="median error [m]",
    runs=30,
    steps=201,
    quick=(4, 80),
    compute=errors,
    judge=judge_errors,
    note="The field of Fig. 3-7 with the two cameras with axes at a right angle; the thesis describes the model "
    "in Sec. 5.2.3. Without x: tracks with the printed triggers, the array's estimate as reference.",
    trial=projection_trial,
)
