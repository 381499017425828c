"""[Lee] Sec. 5.2.3: virtual sensors of readers, and visual refinement.

[Lee] Figs. 5-31 to 5-37: numbers of virtual sensors, coarse positions, and what two cameras make of them.
"""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Floats
from occlog.papers import verdicts as v
from occlog.papers.verdicts import Execute, Experiment, PaperRow, Size, StatementVerdict, Table, quotient_of
from occlog.track.methods.readers.refine import PARALLEL, PRINTED, RAYS, TagSightings, refine
from occlog.track.methods.readers.virtual_sensors import locate, most_virtual_sensors, virtual_sensors

SIDE = 10.0
"""Side of the room [m]."""
SETTINGS = ((9, 2.6), (16, 2.0), (16, 2.6), (25, 2.0))
"""Numbers of readers in a grid, and their range [m]."""
COARSE = "coarse"
FORMS = (PRINTED, PARALLEL, RAYS)
CAMERAS = np.array([[0.0, 0.5 * SIDE], [0.5 * SIDE, 0.0]])
"""(2, 2) positions of the cameras: the middle of the left and of the bottom wall (Fig. 5-36)."""
YAWS = np.array([0.0, 0.5 * np.pi])
SIGMA = 1e-4
"""Standard deviation of the lines of sight [rad]: practically zero."""
ROOM = np.array([[0.0, 0.0], [SIDE, 0.0], [SIDE, SIDE], [0.0, SIDE]])


def name_of(what: str, reach: float) -> str:
    """Name of a series: `coarse, range 2.6 m` with what="coarse"; `reach` in metres."""
    return f"{what}, range {reach:g} m"


def grid(readers: int) -> Floats:
    """(readers, 2) positions [m] on a uniform square grid over the room."""
    n = math.isqrt(readers)
    at = (np.arange(n) + 0.5) * SIDE / n
    return np.stack(np.meshgrid(at, at), axis=2).reshape(-1, 2)


def errors(size: Size, execute: Execute) -> Table:  # noqa: ARG001
    """Table of RMS errors of coarse positions, and of medians of coarse and refined ones, by number of readers [m].

    `size.steps` tags are drawn in each run.
    """
    rows = []
    for readers, reach in SETTINGS:
        positions = grid(readers)
        regions = virtual_sensors(positions, np.full(readers, reach), ROOM)
        rms, medians = [], {form: list[float]() for form in (COARSE, *FORMS)}
        tails = {form: list[float]() for form in FORMS}
        for run in range(size.runs):
            rng = np.random.default_rng(np.random.SeedSequence(size.seed, spawn_key=(2009, 523, readers, run)))
            xy = rng.uniform(0.0, SIDE, (size.steps, 2))
            inside = np.sqrt(((xy[:, None, :] - positions) ** 2).sum(axis=2)) <= reach
            xy, inside = xy[inside.any(axis=1)], inside[inside.any(axis=1)]
            coarse = locate(regions, inside, 1.0, 0.0)
            away = np.sqrt(((coarse.xy - xy) ** 2).sum(axis=1))
            rms.append(float(np.sqrt((away**2).mean())))
            medians[COARSE].append(float(np.median(away)))
            to = xy[:, None, :] - CAMERAS
            bearing = np.arctan2(to[..., 1], to[..., 0])
            sights = TagSightings(CAMERAS, YAWS, bearing, np.full(bearing.shape, SIGMA))
            for form in FORMS:
                found = refine(coarse.xy, coarse.covariance, sights, form)
                error = np.sqrt(((found.xy - xy) ** 2).sum(axis=1))
                medians[form].append(float(np.median(error)))
                tails[form].append(float(np.percentile(error, 95.0)))
        x = float(readers)
        rows.append(PaperRow(name_of(f"{COARSE} RMS", reach), x, tuple(rms)))
        rows += [PaperRow(name_of(form, reach), x, tuple(values)) for form, values in medians.items()]
        rows += [
            PaperRow(name_of(f"{form} p95", reach), x, tuple(values), plotted=False) for form, values in tails.items()
        ]
    return rows


def judge_errors(table: Table) -> list[StatementVerdict]:
    """Verdicts on the accuracy of positions by RFID readers, and after refinement by cameras ([Lee] Sec. 5.2.3)."""

    def rows(what: str) -> list[PaperRow]:
        return [v.row_of(table, name_of(what, reach), float(readers)) for readers, reach in SETTINGS]

    rms, coarse = rows(f"{COARSE} RMS"), rows(COARSE)
    printed, parallel, rays = rows(PRINTED), rows(PARALLEL), rows(RAYS)
    tails, deep_tails = rows(f"{PRINTED} p95"), rows(f"{PARALLEL} p95")
    # 9 to 16 readers of one range; 16 to 25 of another one
    closer = [(rms[2], rms[0]), (rms[3], rms[1])]
    out = [
        v.pairs("readers-closer", "The shorter the distance between readers, the better the coarse position.", closer),
        v.pairs("readers-range", "A smaller range makes the coarse position better (16 readers).", [(rms[1], rms[2])]),
        v.pairs("refine-5.39", "Eq. 5.39 improves the coarse position: median lower by this.", pair(printed, coarse)),
        v.pairs("refine-5.40", "Eq. 5.40 improves the coarse position: median lower by this.", pair(parallel, coarse)),
        v.pairs("refine-depth", "Eq. 5.40 is better than 5.39: median lower by this.", pair(parallel, printed)),
        v.pairs("refine-tail", "Eq. 5.40 has lighter tails than 5.39: 95 % of errors below.", pair(deep_tails, tails)),
        v.pairs(
            "refine-rays", "Crossed lines of sight are better than Eq. 5.39 (of this project).", pair(rays, printed)
        ),
    ]
    nine, twenty_five = printed[0], printed[-1]
    same, fair = v.around(1.0, v.NEAR), v.around(1.0, v.FAR)
    statement = "The refined position hardly depends on the readers (Eq. 5.39): median with 9 over that with 25."
    rule = f"within {v.NEAR:.0%} of 1; in part within {v.FAR:.0%}"
    out.append(v.judge("refine-readers", statement, quotient_of(nine, twenty_five), same, fair, rule=rule, paper=1.0))
    return out


def pair(low: list[PaperRow], high: list[PaperRow]) -> list[tuple[PaperRow, PaperRow]]:
    """Pairs of rows of two series of equal length with the same settings, in their order."""
    return list(zip(low, high, strict=True))


def counts(size: Size, execute: Execute) -> Table:  # noqa: ARG001
    """Table of numbers of virtual sensors: of three circles, of twelve readers (at most two overlap), of eight."""
    angles = np.radians([90.0, 210.0, 330.0])
    three = len(virtual_sensors(np.column_stack([np.cos(angles), np.sin(angles)]), np.full(3, 1.5)).area)
    ring = np.radians(30.0 * np.arange(12))
    positions = 4.0 * np.column_stack([np.cos(ring), np.sin(ring)])
    twelve = virtual_sensors(positions, np.full(12, 1.5))
    # Eight readers in two rows that are not quite even
    rng = np.random.default_rng(np.random.SeedSequence(size.seed, spawn_key=(2009, 531)))
    rows = np.array([(x, y) for y in (0.0, 2.0) for x in (0.0, 2.0, 4.0, 6.0)])
    eight = []
    for _ in range(LAYOUTS):
        moved = rows + rng.uniform(-0.5, 0.5, rows.shape)
        eight.append(float(len(virtual_sensors(moved, np.full(8, EIGHT_RANGE)).area)))
    return [
        PaperRow("three circles", 3.0, (float(three),)),
        PaperRow("twelve readers, at most", 12.0, (float(most_virtual_sensors(12, 2)),)),
        PaperRow("twelve readers in a ring", 12.0, (float(len(twelve.area)),)),
        PaperRow("eight readers in two rows", 8.0, tuple(eight)),
    ]


EIGHT, EIGHT_RANGE, LAYOUTS = 26, 1.4, 20
"""Virtual sensors of the eight readers of Fig. 5-31; range and number of layouts tried, since the figure is lost."""


def judge_counts(table: Table) -> list[StatementVerdict]:
    """Verdicts on the printed numbers of virtual sensors, regions that the same readers cover ([Lee] Sec. 5.2.3)."""
    printed = {
        "three circles": (7, "Three coverages that overlap make 7 virtual sensors (Fig. 5-32)."),
        "twelve readers, at most": (
            78,
            "Of 12 readers, two overlapping at most, there are at most 78 virtual sensors.",
        ),
    }
    out = []
    for series, (paper, statement) in printed.items():
        row = v.row_of(table, series)
        key, holds = f"virtual-{series.split()[0]}", row.mean == paper
        out.append(v.fact(key, statement, holds=holds, measured=row.mean, rule="the same number", paper=float(paper)))
    eight = v.row_of(table, "eight readers in two rows")
    statement = (
        "Eight readers make 26 virtual sensors (the layout is lost): one of the random layouts does; their mean."
    )
    rule = f"one of {eight.runs} layouts has as many; they have {min(eight.values):g} to {max(eight.values):g}"
    holds = float(EIGHT) in eight.values
    out.append(v.fact("virtual-eight", statement, holds=holds, measured=eight.mean, rule=rule, paper=float(EIGHT)))
    ring, most = v.row_of(table, "twelve readers in a ring"), v.row_of(table, "twelve readers, at most")
    statement = "Readers that are far from each other make fewer than the bound: a ring of 12."
    holds = ring.mean <= most.mean
    out.append(
        v.fact("virtual-bound", statement, holds=holds, measured=ring.mean, rule="at most the bound", paper=most.mean)
    )
    return out


READER_EXPERIMENTS = (
    Experiment(
        item="virtual-sensors",
        title="Numbers of virtual sensors",
        x_label="readers",
        y_label="virtual sensors",
        runs=1,
        steps=1,
        quick=(1, 1),
        compute=counts,
        judge=judge_counts,
        note="The layouts of Figs. 5-31 and 5-33 are lost: eight readers are in two uneven rows.",
    ),
    Experiment(
        item="readers",
        title="Coarse positions by virtual sensors, refined by two cameras",
        x_label="readers",
        y_label="error [m]",
        runs=12,
        steps=2000,
        quick=(3, 300),
        compute=errors,
        judge=judge_errors,
        note="Room of 10 m x 10 m, readers in a grid, cameras in the middle of the left and the bottom wall; medians, "
        "and RMS errors of coarse positions. Fig. 5-35, the lens, is lost.",
    ),
)
