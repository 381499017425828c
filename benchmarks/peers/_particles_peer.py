"""The reference scene tracked with the auxiliary filter of the package `particles`; run in an environment of its own.

`python _particles_peer.py SCANS.npz STEP.py`: prints JSON with the time of a step and the tracking error.
STEP.py is the plain NumPy form of the tests; the model is written with its functions, the filter is the package's.
"""

from __future__ import annotations

import importlib
import json
import sys
import time
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import particles
from particles import distributions
from particles import state_space_models as ssm

PARTICLES = 1000
XY, DESTINATION, SPEED, REGIME = slice(0, 2), slice(2, 4), 4, 5


class Drawn(distributions.ProbDist):
    """A distribution known by what draws from it; all that a bootstrap proposal needs."""

    dim = 6

    def __init__(self, draw: Any) -> None:
        self.draw = draw

    def rvs(self, size: int | None = None) -> Any:
        return self.draw(size)


class Weight(distributions.ProbDist):
    """A likelihood, as a function of the state that was given."""

    def __init__(self, log_likelihood: Any) -> None:
        self.log_likelihood = log_likelihood

    def logpdf(self, x: Any) -> Any:
        return self.log_likelihood(x)


class Walk(ssm.StateSpaceModel):
    """The target of [Ercan] Sec. 4.1 and its cameras."""

    def PX0(self) -> Drawn:  # noqa: N802
        return Drawn(lambda size: self.start(size))

    def PX(self, t: int, xp: Any) -> Drawn:  # noqa: N802, ARG002
        return Drawn(lambda size: self.moved(xp))  # noqa: ARG005

    def PY(self, t: int, xp: Any, x: Any) -> Weight:  # noqa: N802, ARG002
        return Weight(lambda z: self.agree(x[:, XY], z))

    def logeta(self, t: int, x: Any, data: Any) -> Any:
        p = self.unpack(x)
        there = self.ref.arrived(p, self.scene, self.config)
        return self.agree(self.ref.expected(p, there, 1.0, self.config), data[t + 1])

    def agree(self, xy: Any, z: Any) -> Any:
        return self.ref.log_likelihood(xy, z, self.sigma, self.scene, self.config)

    def unpack(self, x: Any) -> Any:
        return self.ref.RefParticles(x[:, XY], x[:, DESTINATION], x[:, SPEED], x[:, REGIME], np.ones(len(x)))

    def places(self, n: int) -> Any:
        low, size = self.scene.room.min(axis=0), np.ptp(self.scene.room, axis=0)
        found = low + size * np.random.random((2 * n, 2))  # noqa: NPY002
        found = found[self.ref.on_floor(found, self.scene)]
        return np.resize(found, (n, 2))

    def start(self, n: int) -> Any:
        speed = np.full((n, 1), 1.0)
        return np.hstack([self.places(n), self.places(n), speed, np.zeros((n, 1))])

    def moved(self, x: Any) -> Any:
        n, p = len(x), self.unpack(x)
        there = self.ref.arrived(p, self.scene, self.config)
        draws = self.ref.Draws(0.0, np.random.random(n), np.random.standard_normal((n, 2)), self.places(n))  # noqa: NPY002
        new = self.ref.move(p, there, 1.0, self.config, draws)
        return np.column_stack([new.xy, new.destination, new.speed, new.regime])


def load(path: str) -> ModuleType:
    """The tests' plain form, which imports its neighbour."""
    sys.path.insert(0, str(Path(path).parent))
    return importlib.import_module(Path(path).stem)


def main(scans: str, step: str) -> None:
    """Run the filter over all scans and time every step."""
    ref, given = load(step), np.load(scans)
    cameras = [ref.RefCamera(row[:2], *row[2:]) for row in given["cameras"]]
    model = Walk()
    model.ref, model.config = ref, ref.RefConfig()
    model.scene = ref.RefScene(given["room"], [given["pillar"]], cameras)
    model.sigma = np.full(len(cameras), 2.0)
    np.random.seed(0)  # noqa: NPY002
    data = list(given["z"])
    pf = particles.SMC(fk=ssm.AuxiliaryBootstrap(ssm=model, data=data), N=PARTICLES, resampling="systematic")
    times, errors = [], []
    for k in range(len(data) - 1):
        begin = time.perf_counter()
        next(pf)
        times.append(1e6 * (time.perf_counter() - begin))
        mean = np.average(pf.X[:, XY], weights=pf.W, axis=0)
        errors.append(float(np.hypot(*(mean - given["truth"][k]))))
    rmse = float(np.sqrt(np.mean(np.square(errors[20:]))))
    print(json.dumps({"step us": float(np.median(times[5:])), "rmse": rmse, "version": version("particles")}))


if __name__ == "__main__":
    main(*sys.argv[1:])
