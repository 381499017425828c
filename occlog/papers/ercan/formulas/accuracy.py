"""[Ercan] Fig. 17: each form of Eq. 7 (printed, improved, by quadrature) against Monte Carlo."""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Floats
from occlog.core.occlusion.priors import Priors, gaussian_priors
from occlog.papers import verdicts as v
from occlog.papers.verdicts import Execute, Experiment, PaperRow, Size, StatementVerdict, Table, mean_of

from .blocking import FORMS, blocking

SIGMA, ALPHA, DIAMETER = 2.0, 4.0, 3.33
TOLERANCES = (1.0, 2.0, 3.0, 4.0, 6.0, 10.0)
MOST = 0.5
"""Share above which "most positions" holds."""


def fig17(size: Size, execute: Execute) -> Table:  # noqa: ARG001
    """Table of the share of random positions with probability within some sigma of Monte Carlo, for each form.

    Every run has `size.steps` positions, each with its own prior of one occluder; it is compared with 16 draws of the
    occluder per position, at least 1,000 and at most 10,000 (the paper does not state how many).
    """
    draws = min(10_000, max(1_000, 16 * size.steps))
    shares: dict[tuple[str, float], list[float]] = {(name, k): [] for name in FORMS for k in TOLERANCES}
    worst = dict.fromkeys(FORMS, 0.0)
    for run in range(size.runs):
        rng = np.random.default_rng(np.random.SeedSequence(size.seed, spawn_key=(run, 17)))
        positions, priors = _random(size.steps, rng)
        counted = _monte_carlo(positions, priors, draws, rng)
        exact = _diagonal(positions, priors, FORMS.index("quadrature"))
        # Binomial standard deviation, at least that of one draw: near 0 and 1 it would vanish
        sigma = np.sqrt(np.maximum(exact * (1.0 - exact), 1.0 / draws) / draws)
        for form, name in enumerate(FORMS):
            q = exact if name == "quadrature" else _diagonal(positions, priors, form)
            worst[name] = max(worst[name], float(np.max(np.abs(q - exact))))
            for k in TOLERANCES:
                shares[name, k].append(float(np.mean(np.abs(q - counted) <= k * sigma)))
    return [
        PaperRow(name, k, tuple(values), {"draws": float(draws), "largest_error": worst[name]})
        for (name, k), values in shares.items()
    ]


def _random(n: int, rng: np.random.Generator) -> tuple[Floats, Priors]:
    """Draw n positions (n, 2), 5 to 30 units from a camera at the origin, a prior near the line of sight of each."""
    angle, distance = rng.uniform(-math.pi, math.pi, n), rng.uniform(5.0, 30.0, n)
    positions = distance[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    along, across = rng.uniform(-0.1, 1.2, n), rng.uniform(-6.0, 6.0, n)
    normal = np.column_stack([-np.sin(angle), np.cos(angle)])
    mean = along[:, None] * positions + across[:, None] * normal
    turn = rng.uniform(0.0, math.pi, n)
    e = np.column_stack([np.cos(turn), np.sin(turn)])
    f = np.column_stack([-np.sin(turn), np.cos(turn)])
    covariance = SIGMA**2 * (e[:, :, None] * e[:, None] + f[:, :, None] * f[:, None] / ALPHA)
    return positions, gaussian_priors(mean, covariance, DIAMETER)


def _one(priors: Priors, j: int) -> Priors:
    return gaussian_priors(priors.mean[j : j + 1], _covariances(priors)[j : j + 1], DIAMETER)


def _covariances(priors: Priors) -> Floats:
    e = priors.axis
    f = np.column_stack([-e[:, 1], e[:, 0]])
    s, m = priors.sigma[:, None, None], priors.minor[:, None, None]
    return np.asarray(s**2 * e[:, :, None] * e[:, None] + m**2 * f[:, :, None] * f[:, None])


def _diagonal(positions: Floats, priors: Priors, form: int) -> Floats:
    """Probabilities (n,) that the occluder with prior i hides position i from a camera at the origin.

    `positions` is (n, 2), `priors` are n; `form` is the number of the form of [Ercan] Eq. 7 (see `blocking`).
    """
    camera = np.zeros(2)
    return np.array(
        [blocking(positions[i : i + 1], camera, _one(priors, i), form)[0, 0] for i in range(len(positions))]
    )


def _monte_carlo(positions: Floats, priors: Priors, draws: int, rng: np.random.Generator) -> Floats:
    """Shares (n,) of drawn occluders with a centre in the rectangle from the camera to the position, `DIAMETER` wide.

    Args:
        positions: (n, 2) positions, seen from a camera at the origin.
        priors: n priors, one for each position.
        draws: number of occluders drawn from each.
        rng: random generator.
    """
    out = np.empty(len(positions))
    e = priors.axis
    for i, position in enumerate(positions):
        z = rng.standard_normal((draws, 2)) * (priors.sigma[i], priors.minor[i])
        xy = priors.mean[i] + z[:, :1] * e[i] + z[:, 1:] * (-e[i, 1], e[i, 0])
        length = math.hypot(*position)
        unit = position / length
        along, across = xy @ unit, xy @ np.array([-unit[1], unit[0]])
        out[i] = np.mean((along >= 0.0) & (along <= length) & (np.abs(across) <= 0.5 * DIAMETER))
    return out


def judge17(table: Table) -> list[StatementVerdict]:
    """Verdicts on [Ercan] Fig. 17: whether most of the positions are within the tolerance, for each form."""
    out = []
    rule = f"more than {MOST:.0%} of the positions; in part from half of that"
    for name in FORMS:
        row = v.find(table, name, 3.0)
        if row is None:
            continue
        which = {"printed": "as printed", "improved": "in its improved form"}.get(name, "by quadrature")
        off = row.extra["largest_error"]
        statement = f"Most positions are within 3 sigma of Monte Carlo: Eq. 7 {which} (largest error {off:.3g})."
        out.append(v.judge(f"fig17-{name}", statement, mean_of(row), v.above(MOST), v.above(0.5 * MOST), rule=rule))
    return out


FIG17 = Experiment(
    item="fig17",
    title="Eq. 7 against Monte Carlo",
    x_label="tolerance [sigma of Monte Carlo]",
    y_label="share of positions within it",
    runs=2,
    steps=16_000,
    quick=(2, 400),
    compute=fig17,
    judge=judge17,
    note="Steps are positions: sigma 2, alpha 4, D 3.33.",
)
