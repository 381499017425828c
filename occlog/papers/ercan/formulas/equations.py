"""[Ercan]: the noise of Eq. 2, how occlusions depend on each other (Eqs. 8 and 9), and the cameras of Fig. 5.

The room is that of Fig. 5, as in Fig. 6, with 40 occluders.  Every run draws positions of the target and priors of the
occluders; quantities compared with Monte Carlo or with a limit has the error bars of the runs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from occlog.array_types import Floats
from occlog.core.geometry.camera import noise_variance, planar_offsets
from occlog.core.geometry.visibility import in_view
from occlog.core.occlusion.priors import Priors, gaussian_priors
from occlog.papers import verdicts as v
from occlog.papers.verdicts import (
    Execute,
    Experiment,
    Measure,
    PaperRow,
    Size,
    StatementVerdict,
    Table,
    mean_of,
)

from ..trial import SQUARE, SQUARE_ORDER, Place
from .blocking import QUADRATURE, blocking_all, independent, patterns, seen_by_recursion, seen_exactly

SIDE, FOCAL, FOV = 100.0, 70.0, math.radians(90.0)
SIGMA_POSITION, SIGMA_YAW, SIGMA_READ = 1.0, 0.01, 2.0
OCCLUDERS, SPREAD, DIAMETER = 40, 6.67 / math.sqrt(2.0), 3.33
"""Occluders of Fig. 6, the deviation of their priors along each axis (RMSE_occ 6.67), and their diameter."""
DRAWS = 4000
"""Drawn cameras at each position."""
DEPTHS = (50.0, 100.0)
"""Depths of positions at the edge of the image, where the square counts most."""
SAME = 0.05
APART, FAR = 5.0, 50.0
"""Distance between the two cameras that are close to each other, and least distance of the positions seen by them."""
COUNTS = (2, 4, 6, 8)
VARIANCE, PRINTED = "Eq. 2", "last line of App. B"
RECURSION, INDEPENDENT = "Eqs. 8 and 9", "independent cameras"
CLOSE_PAIR = "more likely hidden from a camera if from one next to it"
VERTICES, EDGES = "seen by a camera on a vertex", "seen by a camera on an edge"
ORTHOGONAL, OPPOSITE = "error with two orthogonal cameras", "error with two opposite cameras"


def equations(size: Size, execute: Execute) -> Table:  # noqa: ARG001
    """Table of the checked quantities of every run; x is the number of cameras for the approximations, else NaN."""
    rows: dict[tuple[str, float], list[float]] = {}
    for run in range(size.runs):
        rng = np.random.default_rng(np.random.SeedSequence(size.seed, spawn_key=(run, 2013)))
        for key, value in {
            **_noise(rng, size.steps),
            **_occlusions(rng, size.steps),
            **_cameras(rng, size.steps),
        }.items():
            rows.setdefault(key, []).append(value)
    return [PaperRow(name, x, tuple(values)) for (name, x), values in rows.items()]


def _noise(rng: np.random.Generator, n_points: int) -> dict[tuple[str, float], float]:
    """Mean ratio of the variance by [Ercan] Eq. 2 to that of drawn readings; with and without the printed square.

    At the edge of the image, without noise of the readout. `n_points` is the number of random depths. The keys are
    name and x (NaN).
    """
    d = rng.uniform(*DEPTHS, n_points)
    h = d * math.tan(0.5 * FOV)
    yaw = SIGMA_YAW * rng.standard_normal((DRAWS, n_points))
    shift = SIGMA_POSITION * rng.standard_normal((2, DRAWS, n_points))
    # The camera, at the origin with its axis along x, is moved by `shift` and turned by `yaw`
    x, y, c, s = d - shift[0], h - shift[1], np.cos(yaw), np.sin(yaw)
    z = FOCAL * (c * y - s * x) / (c * x + s * y)
    drawn = np.mean((z - FOCAL * h / d) ** 2, axis=0)
    right = noise_variance(h, d, FOCAL, SIGMA_POSITION, SIGMA_YAW, 0.0)
    ratio = 1.0 + (h / d) ** 2
    printed = right - (ratio**2 - ratio) * (FOCAL * SIGMA_YAW) ** 2
    return {
        (VARIANCE, math.nan): float(np.mean(right / drawn)),
        (PRINTED, math.nan): float(np.mean(printed / drawn)),
    }


def _occlusions(rng: np.random.Generator, n_points: int) -> dict[tuple[str, float], float]:
    """Mean distances from the exact p(eta) by (name, x), and how much two close cameras depend on each other.

    x is the number of cameras. The means are over `n_points` random positions.
    """
    xy, priors = rng.uniform(0.0, SIDE, (n_points, 2)), _priors(rng)
    ground = np.array([SQUARE[n - 1][:2] for n in SQUARE_ORDER], dtype=np.float64)
    out = {}
    for n in COUNTS:
        q = blocking_all(xy, ground[:n], priors, QUADRATURE)
        exact = patterns(seen_exactly(xy, ground[:n], priors))
        for name, found in ((RECURSION, patterns(seen_by_recursion(q))), (INDEPENDENT, independent(q))):
            out[name, float(n)] = float(np.mean(0.5 * np.abs(found - exact).sum(axis=1)))
    positions = np.array([[0.5 * (SIDE - APART), 0.0], [0.5 * (SIDE + APART), 0.0]])
    away = np.column_stack([xy[:, 0], FAR + (SIDE - FAR) / SIDE * xy[:, 1]])
    p = patterns(seen_exactly(away, positions, priors))  # columns: neither sees it, the first, the second, both
    first, second = p[:, 0] + p[:, 2], p[:, 0] + p[:, 1]  # hidden from it
    out[CLOSE_PAIR, math.nan] = float(np.mean(p[:, 0] / np.maximum(first, 1e-12) - second))
    return out


def _priors(rng: np.random.Generator) -> Priors:
    covariance = np.tile(SPREAD**2 * np.eye(2), (OCCLUDERS, 1, 1))
    return gaussian_priors(rng.uniform(0.0, SIDE, (OCCLUDERS, 2)), covariance, DIAMETER)


def _cameras(rng: np.random.Generator, n_points: int) -> dict[tuple[str, float], float]:
    """Share of the empty room that cameras of [Ercan] Fig. 5 see, and the error of pairs of them, by (name, NaN).

    Means over `n_points` random positions, without occlusions.
    """
    xy = rng.uniform(0.0, SIDE, (n_points, 2))
    share = {n: float(np.mean(_in_view(xy, SQUARE[n - 1]))) for n in SQUARE_ORDER}
    return {
        (VERTICES, math.nan): float(np.mean([share[n] for n in SQUARE_ORDER[:4]])),
        (EDGES, math.nan): float(np.mean([share[n] for n in SQUARE_ORDER[4:]])),
        (ORTHOGONAL, math.nan): _error_of(xy, (1, 7)),
        (OPPOSITE, math.nan): _error_of(xy, (1, 5)),
    }


def _in_view(xy: Floats, position: Place) -> Floats:
    h, d = planar_offsets(xy, np.array(position[:2], dtype=np.float64), math.radians(position[2]))
    return np.asarray(in_view(h, d, FOV + 1e-9, math.inf), dtype=np.float64)


def _error_of(xy: Floats, pair: tuple[int, int]) -> float:
    """Root mean square, over positions `xy` (N, 2), of the least error of two cameras' readings ([Ercan] Eq. 2).

    By the inverse information, with a prior that has the variance of a uniform distribution over the room. `pair` has
    the numbers of the two cameras in `SQUARE`, from 1.
    """
    information = np.tile(12.0 / SIDE**2 * np.eye(2), (len(xy), 1, 1))
    for n in pair:
        x, y, yaw = SQUARE[n - 1]
        h, d = planar_offsets(xy, np.array([x, y], dtype=np.float64), math.radians(yaw))
        axis = np.array([math.cos(math.radians(yaw)), math.sin(math.radians(yaw))])
        left = np.array([-axis[1], axis[0]])
        gradient = FOCAL * (left / d[:, None] - (h / d**2)[:, None] * axis)
        variance = noise_variance(h, d, FOCAL, SIGMA_POSITION, SIGMA_YAW, SIGMA_READ)
        information = information + gradient[:, :, None] * gradient[:, None] / variance[:, None, None]
    return math.sqrt(float(np.mean(np.trace(np.linalg.inv(information), axis1=1, axis2=2))))


def judge(table: Table) -> list[StatementVerdict]:
    """Verdicts on the statements of [Ercan] Secs. 3.1, 4.2 and 6.1 and of App. B, from the table of `equations`."""
    own = {row.series: row for row in table if math.isnan(row.x)}
    return [*_judge_noise(own), *_judge_occlusions(table, own), *_judge_cameras(own)]


def _judge_noise(own: Mapping[str, PaperRow]) -> list[StatementVerdict]:
    rule = f"within {SAME:.0%} of that of drawn cameras; in part within {2.0 * SAME:.0%}"
    near, fair = v.around(1.0, SAME), v.around(1.0, 2.0 * SAME)
    statement = "is the variance that the calibration leaves, at the edge of the image: mean quotient."
    return [
        v.judge("eq2", f"Eq. 2 {statement}", mean_of(own[VARIANCE]), near, fair, rule=rule),
        v.judge(
            "appendix-b",
            f"The last line of App. B, which has no square on its first bracket, {statement}",
            mean_of(own[PRINTED]),
            near,
            fair,
            rule=rule,
        ),
    ]


def _judge_occlusions(table: Table, own: Mapping[str, PaperRow]) -> list[StatementVerdict]:
    close, counts = mean_of(own[CLOSE_PAIR]), len(COUNTS)
    statement = (
        f"Hidden from one of two cameras {APART:g} units apart, a position is more often hidden from the other: mean."
    )
    out = [v.judge("sec4.2-dependent", statement, close, v.above(0.0), rule="above 0 by two standard errors")]
    statement = (
        "Eqs. 8 and 9 approximate p(eta): mean distance in total variation from the exact probabilities, 8 cameras."
    )
    far = mean_of(v.row_of(table, RECURSION, float(COUNTS[-1])))
    out.append(
        v.judge(
            "eq9",
            statement,
            far,
            v.at_most(SAME),
            v.at_most(2.0 * SAME),
            rule=f"at most {SAME:g}; in part {2 * SAME:g}",
        )
    )
    statement = (
        f"They are nearer to them than the product over cameras as if independent, at {counts} numbers of cameras: by."
    )
    return [*out, v.pairs("sec4.2-product", statement, v.matched(table, RECURSION, INDEPENDENT))]


def _judge_cameras(own: Mapping[str, PaperRow]) -> list[StatementVerdict]:
    covered: Measure = mean_of(own[VERTICES])
    statement = (
        f"Cameras on the vertices see more of the room ({covered.value:.0%}) than those on the edges: by this share."
    )
    out = [v.pairs("sec6.1-vertices", statement, [(own[EDGES], own[VERTICES])])]
    statement = "Two orthogonal cameras locate better than two opposite ones: bound of the RMSE lower by this."
    return [*out, v.pairs("sec6.1-orthogonal", statement, [(own[ORTHOGONAL], own[OPPOSITE])])]


EQUATIONS = Experiment(
    item="equations",
    title="Noise, dependent occlusions and positions of cameras",
    x_label="cameras",
    y_label="distance from the exact probabilities",
    runs=20,
    steps=100,
    quick=(3, 20),
    compute=equations,
    judge=judge,
    note="Steps are positions. Lines across: the quantities that are no distances.",
)
