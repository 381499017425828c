"""Variants of the synthetic video of [Qu]: more or fewer balls, smaller or larger ones, more views."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from occlog.papers import verdicts as v
from occlog.papers.verdicts import Execute, Experiment, PaperRow, Size, StatementVerdict, Table, power_of
from occlog.pipeline.sweep.trial import Spec

from .common import METHODS, RATES, everywhere, rate_row, seed_of, spec_of
from .trial import run_views_trial, views_spec

MOST_VIEWS = 4
LINEAR, NEARLY = 1.3, 1.6
"""Largest exponents of a cost that count as linear, and as in part."""


class VideoVariant(NamedTuple):
    """A property of the video that is varied.

    Attributes:
        item: key of the experiment, and name of the setting where it is one.
        label: name of the property.
        title: title of the experiment.
        values, quick: values in the full and in the quick form of the experiment.
        note: what the other properties are.
    """

    item: str
    label: str
    title: str
    values: tuple[float, ...]
    quick: tuple[float, ...]
    note: str


BALLS = VideoVariant(
    item="balls",
    label="balls",
    title="More and fewer balls",
    values=(3, 4, 6, 8, 10),
    quick=(3, 6),
    note="Radius 22 px, two views.",
)
RADIUS = VideoVariant(
    item="radius",
    label="radius of the balls [px]",
    title="Smaller and larger balls",
    values=(12, 15, 18, 22, 25, 28),
    quick=(15, 25),
    note="Six balls, two views.",
)
VIEWS = VideoVariant(
    item="views",
    label="views that are used",
    title="More views",
    values=(1, 2, 3, 4),
    quick=(2, 3),
    note="Six balls of radius 22 px in a video of four views, of which the methods get the first ones; rates are those "
    "of the views that they get.",
)


def compute(variant: VideoVariant, size: Size, execute: Execute) -> Table:
    """Table of false position and false label rates [%] of every method at every value of the varied property.

    Runs of one seed at different values are different videos, except that numbers of views share one.
    """
    points = variant.quick if size.quick else variant.values
    found = _of_views(points, size, execute) if variant is VIEWS else _of_balls(variant, points, size, execute)
    return [
        rate_row(f"{m.upper()}, {name}", x, found[x], m, rate, plotted=rate == "fr_p")
        for rate, name in RATES.items()
        for m in METHODS
        for x in points
    ]


Found = dict[float, Sequence[Mapping[str, float]]]


def _of_balls(variant: VideoVariant, points: Sequence[float], size: Size, execute: Execute) -> Found:
    """Figures of the runs by value of the varied setting of balls; each value has its own videos."""

    def spec(x: float, run: int) -> Spec:
        return spec_of(size, run, **({"radius": float(x)} if variant is RADIUS else {"balls": int(x)}))

    return dict(v.run_trials(points, size, execute, spec))


def _of_views(points: Sequence[float], size: Size, execute: Execute) -> Found:
    """Figures of the runs by number of views, of all methods, from one rendering of each video."""
    methods = {f"{m}, {x:g}": {"method": m, "use": int(x)} for m in METHODS for x in points}
    balls = {"frames": size.steps, "views": MOST_VIEWS}
    results = execute([views_spec(seed_of(size, run), methods, balls) for run in range(size.runs)])
    return {x: [_renamed(r, f", {x:g}") for r in results] for x in points}


def _renamed(result: Mapping[str, float], ending: str) -> dict[str, float]:
    """Figures of those labels of `result` that have an ending, with the ending removed from their names."""
    return {k.replace(f"{ending}.", "."): value for k, value in result.items() if f"{ending}." in k}


def judge(variant: VideoVariant, table: Table) -> list[StatementVerdict]:
    """Verdicts on whether BMCT is better than IDMOT at every value, and whether more views lower its rates."""
    out = []
    for rate, name in RATES.items():
        own = v.series(table, f"BMCT, {name}")
        pairs = v.matched(table, f"BMCT, {name}", f"IDMOT, {name}")
        pairs = [(low, high) for low, high in pairs if variant is not VIEWS or low.x > 1]
        statement = (
            f"Cooperation pays at any number of {variant.label}: mean rate of {name} below that of IDMOT, by [%]."
        )
        out.append(everywhere(f"{variant.item}-{rate}", statement.replace("number of radius", "radius"), pairs))
        if variant is VIEWS:
            statement = (
                f"With more cameras failures are avoided: rate of {name} of BMCT lower with one view more, by [%]."
            )
            out.append(everywhere(f"views-{rate}-more", statement, v.neighbours(own)))
    found = [verdict for verdict in out if verdict is not None]
    return [*found, _cost(variant, table)] if variant in (BALLS, VIEWS) else found


def _cost(variant: VideoVariant, table: Table) -> StatementVerdict:
    """Verdict on whether the CPU time of a frame grows linearly with the targets, or with the views."""
    rows = v.series(table, f"BMCT, {RATES['fr_p']}")
    times = [PaperRow("time", r.x, r.each["frame_ms"]) for r in rows if r.x > 1]  # one view has no collaboration
    what = "cameras" if variant is VIEWS else "targets"
    statement = (
        f"The cost of BMCT grows linearly with the number of {what}: exponent of the CPU time of a frame of all views."
    )
    rule = f"at most {LINEAR:g}; in part {NEARLY:g}"
    limits = v.at_most(LINEAR), v.at_most(NEARLY)
    return v.judge(f"{variant.item}-cost", statement, power_of(times), *limits, rule=rule, paper=1.0)


def _experiment(variant: VideoVariant) -> Experiment:
    """Experiment that varies one property of the video."""
    return Experiment(
        item=variant.item,
        title=f"{variant.title} (of this project)",
        x_label=variant.label,
        y_label="rate of false positions [%]",
        runs=6,
        steps=400,
        quick=(2, 40),
        compute=functools.partial(compute, variant),
        judge=functools.partial(judge, variant),
        trial=run_views_trial,
        note=f"{variant.note} Rates of false labels are in the table.",
    )


VARIANTS = tuple(_experiment(variant) for variant in (BALLS, RADIUS, VIEWS))
