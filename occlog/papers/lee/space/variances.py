"""[Lee] Figs. 2-2 and 2-3: variances of projected angles, and the errors of the printed formulas and rule.

`printed_projection` has Eqs. 2.1 and 2.2 as printed; the verdicts measure where they are wrong.
"""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Floats
from occlog.core.geometry.camera import wrap_angle
from occlog.core.geometry.projected_planes import (
    PLANES,
    YZ,
    ZX,
    blind_planes,
    direction,
    projected_angles,
    projected_covariance,
    select_as_printed,
    select_by_variance,
)
from occlog.papers import verdicts as v
from occlog.papers.verdicts import (
    Execute,
    Experiment,
    Measure,
    PaperRow,
    Size,
    StatementVerdict,
    Table,
    estimate,
    mean_of,
    share_of,
)

SIGMA = math.radians(1.0)
"""Standard deviation of both measured angles; their variances in the figures are 1 degree squared."""
PHIS, THETAS = (15, 30, 60, 75, 90), tuple(range(0, 181, 15))
SHOWN = (30, 60)
"""Polar angles in the plot."""
DRAWS, DIRECTIONS = 4000, 20_000
"""Random angles in each run of a point, and random directions in each run of a share."""
SAME = 0.05
CHANCE = 0.35
"""Largest share of wrong directions of a rule that is in part right; half of them are wrong by chance."""
FIRST, MONTE_CARLO = "first order", "Monte Carlo"
WRONG_YZ, WRONG_ZX, WRONG_RULE, WRONG_BAND = "yz", "zx", "rule", "band"
SHARES = (WRONG_YZ, WRONG_ZX, WRONG_RULE, WRONG_BAND)
EYE = np.eye(3)


def variances(size: Size, execute: Execute) -> Table:  # noqa: ARG001
    """Table of the variance of the projected angle over that of the measured ones, against theta, for some phi.

    Also shares of directions for which printed statements are wrong, at x NaN.
    """
    rows = []
    rng = np.random.default_rng(np.random.SeedSequence(size.seed, spawn_key=(2009, 22)))
    draws = DRAWS // 10 if size.quick else DRAWS
    for p in (YZ, ZX):
        for phi in PHIS:
            for theta in THETAS:
                angles = np.radians(float(theta)), np.radians(float(phi))
                if _blind(*angles, p):
                    continue
                at = np.array(angles[0]), np.array(angles[1])
                first = float(projected_covariance(*at, SIGMA, SIGMA, EYE)[p, p]) / SIGMA**2
                values = tuple(_sampled(*angles, p, draws, rng) for _ in range(size.runs))
                name = f"{PLANES[p]}, phi {phi}"
                rows.append(PaperRow(f"{name}, {FIRST}", float(theta), (first, first), plotted=phi in SHOWN))
                rows.append(PaperRow(f"{name}, {MONTE_CARLO}", float(theta), values, plotted=phi in SHOWN))
    shares = [_wrong_shares(rng) for _ in range(size.runs)]
    return rows + [PaperRow(f"share wrong: {n}", math.nan, tuple(s[n] for s in shares), plotted=False) for n in SHARES]


def _blind(theta: float, phi: float, plane: int) -> bool:
    return bool(
        blind_planes(np.asarray(theta), np.asarray(phi), sigma_theta=SIGMA, sigma_phi=SIGMA, rotation=EYE)[plane]
    )


def _sampled(theta: float, phi: float, plane: int, draws: int, rng: np.random.Generator) -> float:
    """Draw measurements; return the variance of their angle in a plane over that of a measured angle.

    Args:
        theta: true azimuth [rad].
        phi: true polar angle [rad].
        plane: index of the plane.
        draws: number of measurements.
        rng: random generator of their noise.
    """
    noisy = direction(theta + SIGMA * rng.standard_normal(draws), phi + SIGMA * rng.standard_normal(draws))
    true = projected_angles(direction(np.asarray(theta), np.asarray(phi)))[plane]
    return float(np.mean(wrap_angle(projected_angles(noisy)[:, plane] - true) ** 2)) / SIGMA**2


def printed_projection(theta: Floats, phi: Floats) -> Floats:
    """Projected angles by [Lee] Eqs. 2.1 and 2.2 as printed, which are wrong on most of the sphere.

    They are wrong for yz where x < 0, on half of the sphere, since |sec theta| should be sec theta; and for
    zx everywhere but where x >= 0 and z >= 0, on three quarters: also |sec|, and the case
    gamma = pi is printed for x < 0 and not for z < 0.  `projected_angles` is right.

    Args:
        theta: (...,) azimuth [rad].
        phi: (...,) polar angle [rad].

    Returns:
        (..., 3) angles in the planes xy, yz, zx [rad]; zx is NaN where z < 0 and x >= 0, for which no case is
        printed.  Where two cases are (z >= 0, x < 0), the first one holds.
    """
    x, y, z = np.moveaxis(direction(theta, phi), -1, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        secant = np.abs(1.0 / np.cos(theta))
        yz = np.arctan(secant / (np.tan(theta) * np.tan(phi)))
        zx = np.arctan(np.tan(phi) / secant)
    beta = np.where(y < 0, np.pi, np.where(z < 0, 2.0 * np.pi, 0.0))
    gamma = np.where(x < 0, np.pi, np.where(z < 0, np.nan, 0.0))
    return np.stack(np.broadcast_arrays(np.mod(theta, 2.0 * np.pi), yz + beta, zx + gamma), axis=-1)


def _wrong_shares(rng: np.random.Generator) -> dict[str, float]:
    """Shares of random directions for which a printed statement is wrong, by name.

    yz, zx: the projected angles of [Lee] Eqs. 2.1 and 2.2. rule: the plane in addition to xy is not the better one of
    yz and zx. band: for phi from 45 to 135 degrees the variance of yz is not below that of the measurement.
    """
    theta = rng.uniform(-math.pi, math.pi, DIRECTIONS)
    phi = np.arccos(rng.uniform(-1.0, 1.0, DIRECTIONS))
    off = np.abs(wrap_angle(printed_projection(theta, phi) - projected_angles(direction(theta, phi))))
    wrong = ~(off < 1e-9)  # NaN is wrong
    variance, chosen = _variances(theta, phi), select_as_printed(phi[:, None])[:, 0, 1]
    better = np.where(variance[:, YZ] < variance[:, ZX], YZ, ZX)
    band = np.abs(phi - 0.5 * math.pi) < 0.25 * math.pi
    return {
        WRONG_YZ: float(wrong[:, YZ].mean()),
        WRONG_ZX: float(wrong[:, ZX].mean()),
        WRONG_RULE: float(np.mean(chosen != better)),
        WRONG_BAND: float(np.mean(variance[band, YZ] >= 1.0)),
    }


def _variances(theta: Floats, phi: Floats) -> Floats:
    """(N, 3) first-order variances of the angles in the planes xy, yz, zx over that of the measurements.

    `theta` (N,) are azimuths, `phi` (N,) polar angles [rad].
    """
    return np.diagonal(projected_covariance(theta, phi, sigma_theta=1.0, sigma_phi=1.0, rotation=EYE), axis1=1, axis2=2)


def xy_is_worst(seed: int) -> float:
    """Share of random directions for which xy is not among the two planes of least variance."""
    rng = np.random.default_rng(seed)
    theta = rng.uniform(-math.pi, math.pi, DIRECTIONS)
    variance = _variances(theta, np.arccos(rng.uniform(-1.0, 1.0, DIRECTIONS)))
    pairs = select_by_variance(variance[:, None, :], np.zeros_like(variance[:, None, :], dtype=np.bool_))
    return float(np.mean(~np.any(pairs[:, :, 1] == 0, axis=1)))


def judge(table: Table) -> list[StatementVerdict]:
    """Verdicts on first order against Monte Carlo, and on the statements of [Lee] Secs. 2.1.2 and 2.2.1."""
    points = []
    for row in table:
        if row.series.endswith(FIRST):
            drawn = v.row_of(table, row.series.replace(FIRST, MONTE_CARLO), row.x)
            off = estimate(drawn.mean / row.mean - 1.0, drawn.error / row.mean, drawn.runs)
            points.append(v.StatementPoint(off, v.Interval(-SAME, SAME)))
    statement = (
        f"First-order variances agree with Monte Carlo where they hold: largest deviation of {len(points)} points."
    )
    worst = max((p.measure for p in points), key=lambda m: abs(m.value), default=None)
    out = [v.judge_points("variances-first-order", statement, points, rule=f"within {SAME:.0%}", shown=worst)]
    statements = {
        WRONG_YZ: ("Eq. 2.1 and 2.2 project on yz: share of directions where they are wrong.", 0.001),
        WRONG_ZX: ("Eq. 2.1 and 2.2 project on zx: share of directions where they are wrong.", 0.001),
        WRONG_RULE: ("yz is better than zx if and only if phi is between 45 and 135 degrees: share where not.", 0.05),
        WRONG_BAND: (
            "For phi between 45 and 135 degrees yz has a variance below that measured: share where not.",
            0.05,
        ),
    }
    for name, (text, limit) in statements.items():
        share_row = v.row_of(table, f"share wrong: {name}")
        out.append(_rarely(f"variances-{name}", text, mean_of(share_row), limit))
    never = share_of(round(xy_is_worst(0) * DIRECTIONS), DIRECTIONS)
    statement = "xy always is the second best plane: share of directions where it is the worst one."
    return [*out, _rarely("variances-xy", statement, never, 0.01)]


def _rarely(key: str, statement: str, wrong: Measure, limit: float) -> StatementVerdict:
    """Verdict on a statement that should be wrong for few directions; in part: for fewer than by chance.

    Args:
        key: id of the verdict.
        statement: text of the statement.
        wrong: share of directions for which it is wrong, 0 to 1.
        limit: largest share.
    """
    rule = f"at most {limit:g}; in part: at most {CHANCE:g} (chance is 0.5)"
    return v.judge(key, statement, wrong, v.at_most(limit), v.at_most(CHANCE), rule=rule, paper=0.0)


VARIANCES = Experiment(
    item="variances",
    title="Variances of projected angles",
    x_label="theta [deg]",
    y_label="variance to that of the measurement",
    runs=20,
    steps=10,
    quick=(3, 10),
    compute=variances,
    judge=judge,
    note="Angles with a standard deviation of 1 degree; not where a plane is blind. More polar "
    "angles, and the shares of directions for which the printed formula is wrong, are in the table.",
)
