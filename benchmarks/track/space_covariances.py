"""Covariances of `direct3d` with one array, filtered and smoothed, beside the exact posterior of the same directions.

Scenario 1 of [Lee]: one array, angles of 1.7 degrees, a motion without noise.  One state then decides all others, and
what is known of it from all directions together is found by Gauss-Newton (`batch`).  The errors of a run are
those of one state: the mean normalised squared error of n runs is known to about sqrt(6 / n).

`python -m benchmarks.track.space_covariances` prints the table.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np

from occlog.array_types import Floats
from occlog.papers.lee.space import worlds
from occlog.track.interface import Estimate, SmoothedState
from occlog.track.methods.in_space import direct3d
from occlog.track.methods.in_space.config import Direct3dConfig
from occlog.track.methods.in_space.importance_step import drift_matrix

RUNS, STEPS, PARTICLES = 30, 50, (1000, 2000, 10000)
ITERATIONS = 20


def normalised(found: Sequence[Estimate | SmoothedState], truth: Floats) -> tuple[float, float]:
    """Mean normalised squared error and mean squared error of (T, 3) true places."""
    nees, square = [], []
    for one, x in zip(found, truth, strict=True):
        assert one.height is not None
        across = one.height.covariance
        P = np.block([[one.covariance, across[:2, None]], [across[None, :]]])
        off = np.array([*one.xy, one.height.z]) - x
        nees.append(off @ np.linalg.solve(P, off))
        square.append(off @ off)
    return float(np.mean(nees)), float(np.mean(square))


def batch(world: worlds.SpaceWorld, angles: Floats, start: Floats) -> tuple[float, float]:
    """The same of the mode of the first state given all (T, 2) azimuths and elevations, with its information."""
    at, T = start.copy(), len(world.states)
    times = np.cumsum(world.dt)
    ways = np.array([drift_matrix(3, t) for t in times])
    # What the known acceleration adds does not depend on the state
    added = world.states - np.einsum("tij,j->ti", ways, world.states[0])
    information = np.linalg.inv(world.P0)
    for _ in range(ITERATIONS):
        d = np.einsum("tij,j->ti", ways, at)[:, :3] + added[:, :3] - world.positions[0]
        flat, square = np.hypot(d[:, 0], d[:, 1]), np.sum(d**2, axis=1)
        slopes = np.zeros((T, 2, 6))
        slopes[:, 0, 0], slopes[:, 0, 1] = -d[:, 1] / flat**2, d[:, 0] / flat**2
        slopes[:, 1, :3] = (
            np.column_stack([-d[:, 0] * d[:, 2] / flat, -d[:, 1] * d[:, 2] / flat, flat]) / square[:, None]
        )
        rows = (slopes @ ways).reshape(-1, 6)
        rest = angles - np.column_stack([np.arctan2(d[:, 1], d[:, 0]), np.arctan2(d[:, 2], flat)])
        rest[:, 0] = np.angle(np.exp(1j * rest[:, 0]))
        information = np.linalg.inv(world.P0) + rows.T @ rows / worlds.SIGMA**2
        gradient = rows.T @ rest.ravel() / worlds.SIGMA**2 + np.linalg.solve(world.P0, start - at)
        at = at + np.linalg.solve(information, gradient)
    covariance = ways @ np.linalg.inv(information) @ ways.transpose(0, 2, 1)
    off = (ways @ (at - world.states[0]))[:, :3]
    nees = np.einsum("ti,ti->t", off, np.linalg.solve(covariance[:, :3, :3], off[:, :, None])[:, :, 0])
    return float(nees.mean()), float(np.mean(np.sum(off**2, axis=1)))


def one_run(run: int, particles: int) -> dict[str, tuple[float, float]]:
    """Normalised and plain squared errors of a run: filter, smoother, batch."""
    world = worlds.world(1, STEPS)
    rng = np.random.default_rng([run, 2009])
    spread = np.sqrt(np.diag(world.P0))
    start = world.states[0] + spread * rng.standard_normal(6)
    scans = worlds.scans(world, rng)
    config = Direct3dConfig(
        particles=particles, start=(*start, *spread), initial_particle_factor=1,
        process_noise_density=0.0, track_loss_count=0,
        acceleration=worlds.ACCELERATION, smooth=True,
    )  # fmt: skip
    state, estimates, traces = direct3d.init(worlds.scene_of(world), config, rng), [], []
    smoothing = direct3d.METHOD.smoothing
    assert smoothing is not None
    for scan in scans:
        state, estimate = direct3d.step(state, scan, rng)
        estimates.append(estimate)
        traces.append(smoothing.trace(state))
    angles = np.array([[scan.bearing[0], scan.elevation[0]] for scan in scans])
    truth = world.states[:, :3]
    return {
        "filter": normalised(estimates, truth),
        "smoothed": normalised(smoothing.back(traces, config, rng), truth),
        "batch": batch(world, angles, start),
    }


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=RUNS)
    parser.add_argument("--particles", type=int, nargs="+", default=list(PARTICLES))
    options = parser.parse_args()
    print("| particles | filter: NEES, RMSE m | smoothed | all directions at once |\n|---|---|---|---|")
    for particles in options.particles:
        runs = [one_run(run, particles) for run in range(options.runs)]
        cells = []
        for name in ("filter", "smoothed", "batch"):
            nees, square = np.mean([run[name] for run in runs], axis=0)
            cells.append(f"{nees:.1f}, {np.sqrt(square):.2f}")
        print(f"| {particles} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
