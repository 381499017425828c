"""[Lee] Fig. 2-7: sums of unnormalised weights of a plane's particles and of particles in space, against the noise.

The text has 100 particles, and not where the target is or how they are spread.  Here they are drawn around
the true positions of scenario 1, where the planes xy and yz are selected, with the prior of the scenarios.  A weight is
the density of the measurement (Alg. 1): of one angle in the plane, of two in space.  Densities of one and of two angles
have different units, so that their order depends on the unit of angles; a relative change does not.
"""

from __future__ import annotations

import math
from itertools import product

import numpy as np

from occlog.array_types import Floats
from occlog.core.bounds.in_space import sight_angles
from occlog.core.geometry.camera import wrap_angle
from occlog.core.geometry.projected_planes import YZ, direction, projected_angles, projected_covariance
from occlog.papers import verdicts as v
from occlog.papers.verdicts import Execute, Experiment, PaperRow, Size, StatementVerdict, Table
from occlog.pipeline.sweep.trial import Spec

from .worlds import world

SCENARIO = 1
VARIANCES = (0.5, 1.0, 2.0, 3.0, 5.0, 10.0)
"""Variances of both original measurements [deg^2]; 3 is that of the scenarios."""
PARTICLES = 100
PLANE, SPACE = "yz-plane", "space"
UNITS = {"degrees": 1.0, "radians": math.degrees(1.0)}
"""Degrees in a unit of angle."""


def weight_trial(spec: Spec) -> dict[str, float]:
    """Sums of the weights of particles in a plane and in space, at each variance of the measurements.

    At each instant particles are drawn around the true position, and one pair of measured angles.

    Args:
        spec: `seed`, `run` and `steps`, the number of instants.

    Returns:
        For each value of `VARIANCES` (as in the key) `plane_VARIANCE` [1/deg], the sum of weights in the plane yz, and
        `space_VARIANCE` [1/deg^2], that in space; means over the instants. The draws are the same for all variances.
    """
    rng = np.random.default_rng(np.random.SeedSequence(spec["seed"], spawn_key=(spec["run"], 2009, 27)))
    w = world(SCENARIO, spec["steps"])
    positions, T = w.states[:, :3], len(w.states)
    cloud = positions[:, None] + w.prior[0] * rng.standard_normal((T, PARTICLES, 3))
    normals = rng.standard_normal((T, 2))
    theta, phi = sight_angles(positions, np.zeros(3), np.eye(3))
    own = [a.reshape(T, PARTICLES) for a in sight_angles(cloud.reshape(-1, 3), np.zeros(3), np.eye(3))]
    out = {}
    for variance in VARIANCES:
        sigma = math.radians(math.sqrt(variance))
        heard = theta + sigma * normals[:, 0], phi + sigma * normals[:, 1]
        # Weights in space: the density of both angles
        off = [wrap_angle(own[i] - heard[i][:, None]) for i in range(2)]
        space = _density(off[0], np.full(T, sigma)) * _density(off[1], np.full(T, sigma))
        # Weights in the plane: the density of the projected angle, with its first-order variance
        spread = np.sqrt(projected_covariance(*heard, sigma, sigma, np.eye(3))[:, YZ, YZ])
        angle = projected_angles(direction(*heard))[:, YZ]
        plane = _density(wrap_angle(projected_angles(cloud)[..., YZ] - angle[:, None]), spread)
        out[f"plane_{variance:g}"] = float(plane.sum(axis=1).mean())
        out[f"space_{variance:g}"] = float(space.sum(axis=1).mean())
    return out


def _density(off: Floats, sigma: Floats) -> Floats:
    """Return the Gaussian densities (T, L) [1/deg] of differences `off` (T, L) with deviations `sigma` (T,) [rad]."""
    s = sigma[:, None]
    return np.asarray(np.exp(-0.5 * (off / s) ** 2) / (math.sqrt(2.0 * math.pi) * np.degrees(s)))


def sums(size: Size, execute: Execute) -> Table:
    """Table of the sums of weights against the variance, in degrees, in radians, and relative to the least variance."""
    results = execute([{"paper": "lee27", "seed": size.seed, "run": r, "steps": size.steps} for r in range(size.runs)])
    rows = []
    for (name, key, angles), x in product(((PLANE, "plane", 1), (SPACE, "space", 2)), VARIANCES):
        value = np.array([r[f"{key}_{x:g}"] for r in results])
        least = np.mean([r[f"{key}_{VARIANCES[0]:g}"] for r in results])
        for unit, scale in UNITS.items():
            rows.append(
                PaperRow(f"{name}, {unit}", x, tuple((value * scale**angles).tolist()), plotted=unit == "degrees")
            )
        rows.append(PaperRow(f"{name}, relative", x, tuple((value / least).tolist()), plotted=False))
    return rows


def judge_sums(table: Table) -> list[StatementVerdict]:
    """Verdicts on [Lee] Fig. 2-7: sums of weights in a plane are larger than in space, and depend less on the noise."""
    out = []
    keys = {"degrees": "fig2.7-larger", "radians": "fig2.7-unit"}
    for unit, key in keys.items():
        statement = f"The sum of weights of the yz-plane is larger than that in space (densities in {unit})."
        out.append(v.pairs(key, statement, v.matched(table, f"{SPACE}, {unit}", f"{PLANE}, {unit}")))
    statement = "A larger variance lowers the sum of the yz-plane by a smaller share than that in space."
    points = v.matched(table, f"{SPACE}, relative", f"{PLANE}, relative", VARIANCES[1:])
    out.append(v.pairs("fig2.7-sensitive", statement, points))
    return out


FIG2_7 = Experiment(
    item="fig2.7",
    title="Sums of unnormalised weights against the variance of the measurements",
    x_label="variance [deg^2]",
    y_label="sum of the weights of 100 particles",
    runs=100,
    steps=50,
    quick=(10, 50),
    compute=sums,
    judge=judge_sums,
    note="Particles around true positions of scenario 1 with a standard deviation of 0.3 m per axis. A density of two "
    "angles has another unit than one of a single angle: the order of the sums depends on the unit.",
    trial=weight_trial,
)
