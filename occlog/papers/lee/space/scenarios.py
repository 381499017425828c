"""[Lee] Sec. 2.4: errors of both methods in scenarios 1 to 4 against their bounds, and against the particles."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from occlog.array_types import Floats
from occlog.core.bounds.in_space import sight_angles
from occlog.core.geometry.projected_planes import YZ, select_as_printed
from occlog.papers import verdicts as v
from occlog.papers.verdicts import (
    Execute,
    Experiment,
    PaperRow,
    Size,
    StatementVerdict,
    Table,
    estimate,
    exact,
    mean_of,
)
from occlog.pipeline.sweep.trial import Spec, Values

from .worlds import AXIS_NAMES, bounds, space_spec, space_trial, world

DIRECT, PPS, THESIS = "direct3d", "pps", "pps as printed"
WAYS: dict[str, tuple[str, Values]] = {
    DIRECT: ("direct3d", {}),
    PPS: ("pps", {}),
    THESIS: (
        "pps",
        {
            "selection": "printed",
            "running": "selected",
            "per_plane": "best",
            "combining": "planes-weighted",
            "proposal": "bootstrap",
        },
    ),
}
DIRECT_COPIES, PPS_COPIES = "direct3d, copies", "pps, copies"
COUNTED_WAYS: dict[str, tuple[str, Values]] = {
    **WAYS,
    DIRECT_COPIES: ("direct3d", {"kernel_bandwidth": 0.0, "proposal": "bootstrap"}),
    PPS_COPIES: ("pps", {"kernel_bandwidth": 0.0, "proposal": "bootstrap"}),
}
"""Ways of the experiment on particles; `copies`: resampled particles are not moved, as in the thesis."""
DIRECT_BOUND, PLANES_BOUND = "bound", "bound of the planes"
PARTICLES, FEW = 10_000, 300
"""Particles of a filter in the full form and in the quick one."""
COUNTS = (100, 300, 1000, 3000, 10_000)
NEAR = 1.35
"""Largest ratio of an error to its bound that counts as reaching it."""
EVERY = 5
"""Instants between points of the plots."""
# Printed ranges of the angles [deg], by scenario
PRINTED_PHI = {1: (45.36, 76.74), 2: (25.24, 36.26), 3: (28.07, 48.24)}
PRINTED_THETA = {1: (45.00, 49.04), 2: (45.00, 50.28)}


def root_mean(squares: Sequence[float] | Floats) -> tuple[float, ...]:
    """Values of each run with the root of the mean of `squares` as mean, and that root's standard error.

    `squares` (runs,) are mean squared errors.
    """
    x = np.asarray(squares, dtype=np.float64)
    root = math.sqrt(float(x.mean()))
    return tuple((root + (x - root**2) / (2.0 * root)).tolist()) if root > 0 else tuple(np.zeros(len(x)).tolist())


def scenario_table(scenario: int, size: Size, execute: Execute) -> Table:
    """Table of RMSE and bounds in scenario 1 to 4 at every fifth instant; at x NaN over all instants.

    In space and for each axis; the plot shows those in space.
    """
    rows, T = [], size.steps
    for (way, _, _), own in _trials([(way, scenario, _particles(size)) for way in WAYS], size, execute):
        extra = {"xy_yz": math.fsum(r["xy_yz"] for r in own) / len(own)}
        square = np.array([[[r[f"{a}_{k}"] for k in range(T)] for r in own] for a in AXIS_NAMES])
        rows += _rows(way, square, extra)
    for name, bound in zip((DIRECT_BOUND, PLANES_BOUND), bounds(scenario, T), strict=True):
        rows += _rows(name, np.repeat(bound.T[:, None] ** 2, 2, axis=1), {})
    return rows


def _trials(
    points: Iterable[tuple[str, int, int]], size: Size, execute: Execute
) -> list[tuple[tuple[str, int, int], list[dict[str, float]]]]:
    """Run the trials of all points: way of `COUNTED_WAYS`, scenario and number of particles of a filter."""

    def spec(point: tuple[str, int, int], run: int) -> Spec:
        (method, settings), (_, scenario, particles) = COUNTED_WAYS[point[0]], point
        return space_spec(size, run, scenario, method=method, particles=particles, **settings)

    return v.run_trials(points, size, execute, spec)


def _particles(size: Size) -> int:
    """Number of particles of a filter in this form of an experiment."""
    return FEW if size.quick else PARTICLES


def _rows(name: str, square: Floats, extra: dict[str, float]) -> Table:
    """Rows of one method: RMSE in space and of each axis at some instants, and of each axis overall.

    Args:
        name: name of the method.
        square: (3, runs, T) squared errors of each axis.
        extra: further figures of each row.
    """
    T = square.shape[2]
    rows = [PaperRow(name, _time(k), root_mean(square[:, :, k].sum(axis=0)), extra) for k in _instants(T)]
    for a, own in zip(AXIS_NAMES, square, strict=True):
        rows += [PaperRow(f"{name} {a}", _time(k), root_mean(own[:, k]), extra, plotted=False) for k in _instants(T)]
        rows.append(PaperRow(f"{name} {a} overall", math.nan, root_mean(own.mean(axis=1)), extra, plotted=False))
    return rows


def judge_scenario(scenario: int, table: Table) -> list[StatementVerdict]:
    """Verdicts on one of the four scenarios ([Lee] Secs. 2.4 and 2.5): PPS against the direct method, and bounds."""
    found = {
        name: [v.row_of(table, f"{name} {a} overall") for a in AXIS_NAMES]
        for name in (*WAYS, DIRECT_BOUND, PLANES_BOUND)
    }
    key = f"scenario{scenario}"
    better = "The method PPS outperforms the direct method: difference of the RMSE [m], axis by axis"
    return [
        *_angles(scenario),
        v.pairs(f"{key}-pps-better", f"{better}.", list(zip(found[PPS], found[DIRECT], strict=True))),
        v.pairs(
            f"{key}-printed-better",
            f"{better} (selection, sensors and combining as printed).",
            list(zip(found[THESIS], found[DIRECT], strict=True)),
        ),
        _reaches(f"{key}-direct-bound", "The direct method reaches its bound", found[DIRECT], found[DIRECT_BOUND]),
        _reaches(f"{key}-pps-bound", "PPS reaches the bound of its planes", found[PPS], found[PLANES_BOUND]),
        _below(f"{key}-bounds", found[PLANES_BOUND], found[DIRECT_BOUND]),
    ]


def _reaches(key: str, stated: str, rows: Sequence[PaperRow], bound: Sequence[PaperRow]) -> StatementVerdict:
    """Verdict on the ratio of error and bound on every axis; the largest is shown.

    Args:
        key: id of the verdict.
        stated: words of the statement.
        rows: RMSE of each axis.
        bound: bound of each axis.
    """
    points = [
        v.StatementPoint(estimate(r.mean / b.mean, r.error / b.mean, r.runs), v.at_most(NEAR))
        for r, b in zip(rows, bound, strict=True)
    ]
    worst = max((p.measure for p in points), key=lambda m: m.value, default=None)
    statement = f"{stated}: RMSE over all instants to it, on the axis where that is most ({PARTICLES} particles)."
    return v.judge_points(key, statement, points, rule=f"at most {NEAR:g} on every axis", shown=worst)


def _below(key: str, planes: Sequence[PaperRow], direct: Sequence[PaperRow]) -> StatementVerdict:
    """Verdict on whether the bound of standard deviations by projected planes is below the direct bound on some axis.

    Args:
        key: id of the verdict.
        planes: rows of the bound of the projected planes, one for each axis.
        direct: rows of the bound of the direct method, one for each axis.
    """
    ratio = exact(min(p.mean / d.mean for p, d in zip(planes, direct, strict=True)))
    statement = (
        "PPS has the lower bound (the thesis' figures): bound of the planes to the direct one, where that is least."
    )
    return v.judge(key, statement, ratio, v.below(1.0 - 1e-9), rule="below 1 on some axis")


def _angles(scenario: int) -> list[StatementVerdict]:
    """Verdicts on the printed ranges of the angles in a `scenario`, in the full form of 50 instants."""
    xyz = world(scenario, 50).states[:, :3]
    theta, phi = (np.rad2deg(a) for a in sight_angles(xyz, np.zeros(3), np.eye(3)))
    out = []
    for name, angle, printed in (("phi", phi, PRINTED_PHI), ("theta", theta, PRINTED_THETA)):
        if scenario in printed:
            off = float(np.max(np.abs(np.array([angle.min(), angle.max()]) - printed[scenario])))
            low, high = printed[scenario]
            statement = f"{name} is between {low:g} and {high:g} degrees: largest difference of an end."
            key, rule = f"scenario{scenario}-{name}", "to the printed digits"
            out.append(v.judge(key, statement, exact(off), v.below(0.00501), rule=rule, paper=0.0))
    if scenario == 3:
        count = int(np.sum(select_as_printed(np.deg2rad(phi)[:, None])[:, 0, 1] == YZ))
        statement = (
            "By the printed rule, xy and yz are selected in the first instants, xy and zx later: number of the first."
        )
        good = v.Interval(13.0, 13.0)
        out.append(
            v.judge("scenario3-switch", statement, exact(float(count)), good, rule="the same number", paper=13.0)
        )
    return out


def particles_table(size: Size, execute: Execute) -> Table:
    """Table of the RMSE in space over the direct bound, of all four scenarios, against the number of particles."""
    counts = COUNTS[:2] if size.quick else COUNTS
    points = [(way, n) for way in COUNTED_WAYS for n in counts]
    numbers = (1, 2, 3, 4)
    shares = {point: np.zeros(size.runs) for point in points}
    floor = {s: float(np.mean(np.sum(bounds(s, size.steps)[0] ** 2, axis=1))) for s in numbers}
    for (way, s, n), own in _trials([(way, s, n) for way, n in points for s in numbers], size, execute):
        shares[way, n] += np.array(_mean_squares(own, size.steps)) / floor[s] / len(numbers)
    return [PaperRow(way, float(n), root_mean(shares[way, n])) for way, n in points]


def _mean_squares(results: Iterable[Mapping[str, float]], steps: int) -> list[float]:
    """Mean square error in space of each trial over its instants [m^2]."""
    return [math.fsum(r[f"{a}_{k}"] for a in AXIS_NAMES for k in range(steps)) / steps for r in results]


def judge_particles(table: Table) -> list[StatementVerdict]:
    """Verdicts on where PPS helps: everywhere ([Lee]), or if the filter in space has few particles (this project)."""
    few, many = (100.0, 300.0), (3000.0, 10_000.0)
    statement = "PPS has the lower error, relative to the direct bound"
    out = [
        v.pairs(
            "particles-few", f"{statement}, with 100 and 300 particles a filter.", v.matched(table, PPS, DIRECT, few)
        ),
        v.pairs("particles-many", f"{statement}, with 3000 and 10000.", v.matched(table, PPS, DIRECT, many)),
        v.pairs(
            "particles-copies-few",
            f"{statement}, with 100 and 300 (mere copies).",
            v.matched(table, PPS_COPIES, DIRECT_COPIES, few),
        ),
        v.pairs(
            "particles-printed-few",
            f"{statement}, with 100 and 300 (as printed).",
            v.matched(table, THESIS, DIRECT, few),
        ),
        v.pairs(
            "particles-printed-many",
            f"{statement}, with 3000 and 10000 (as printed).",
            v.matched(table, THESIS, DIRECT, many),
        ),
    ]
    last = v.find(table, DIRECT, many[1])
    if last is not None:
        statement = "The direct method is near its bound at 10000 particles: RMSE in space to it, all scenarios."
        near, twice = v.at_most(NEAR), v.at_most(2.0 * NEAR)
        rule = f"at most {NEAR:g}; in part: twice that"
        out.append(v.judge("particles-bound", statement, mean_of(last), near, twice, rule=rule))
    return out


def sensors_table(size: Size, execute: Execute) -> Table:
    """Table of the RMSE over all instants with one array (scenario 3) and with two (scenario 4)."""
    points = [(way, s, _particles(size)) for way in WAYS for s in (3, 4)]
    return [
        PaperRow(way, float(s - 2), root_mean(_mean_squares(own, size.steps)))
        for (way, s, _), own in _trials(points, size, execute)
    ]


def judge_sensors(table: Table) -> list[StatementVerdict]:
    """Verdicts on the statement of [Lee] Sec. 2.4.5 that several sensors are better than one."""
    out = []
    for way in WAYS:
        one, two = v.row_of(table, way, 1.0), v.row_of(table, way, 2.0)
        statement = f"Two arrays give a lower error than one (Figs. 2-12, 2-13; {way}): difference of the RMSE [m]."
        out.append(v.pairs(f"sensors-{way.replace(' ', '-')}", statement, [(two, one)]))
    return out


def _instants(T: int) -> range:
    return range(0, T, EVERY)


def _time(k: int) -> float:
    return round(0.1 * k, 6)


_experiment = functools.partial(Experiment, runs=100, steps=50, quick=(3, 20), trial=space_trial)


def _scenario(number: int) -> Experiment:
    return _experiment(
        item=f"scenario{number}",
        title=f"Errors and bounds in scenario {number}",
        x_label="time [s]",
        y_label="RMSE in space [m]",
        compute=functools.partial(scenario_table, number),
        judge=functools.partial(judge_scenario, number),
        note=f"{PARTICLES} particles, for PPS in each plane. Errors along x, y and z are in the table.",
    )


SCENARIOS = tuple(_scenario(number) for number in (1, 2, 3, 4))
COUNTED = _experiment(
    item="particles",
    title="Particles against error, scenarios 1 to 4",
    x_label="particles of a filter",
    y_label="RMSE to the direct bound",
    compute=particles_table,
    judge=judge_particles,
    note="PPS has this many in each plane. Copies: resampled particles are not moved (`kernel=0`).",
)
SENSORS = _experiment(
    item="sensors",
    title="One array and two",
    x_label="arrays",
    y_label="RMSE in space [m]",
    compute=sensors_table,
    judge=judge_sensors,
)
