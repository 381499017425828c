"""Ranges, signal strengths and time differences: RMSE over the Cramér-Rao bound, NEES and coverage, by kind and method.

`python -m benchmarks ranges` measures `map` with sharp ranges; the table of docs/explanation/ranges.md is printed by
`python -m benchmarks.track.ranges`.
"""

from __future__ import annotations

import argparse
from typing import Any, NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints
from occlog.core.geometry.path_loss import received_power
from occlog.core.metrics.errors import normalised_squared_errors
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.stage import evaluate
from occlog.filtering.likelihood.distances import information, residuals_at_own_position
from occlog.records.declared.sensors import Measurements
from occlog.records.scene import MicrophoneArray, Scene
from occlog.records.tables import Diagnostics, Tracks, Truth
from occlog.scans.config import DistanceMeasurementConfig
from occlog.scans.distance_measurements import DistanceMeasurementFeed, make_stations, pack
from occlog.settings import configure
from occlog.track.catalogue import settings_of
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask

NAME = "ranges"
SUMMARY = "RMSE of map with ranges of 0.05 m to the bound of smoothing, four stations"
LIMIT = 1.2
ELLIPSE = 5.991
"""95 % of a chi-squared variable with two degrees of freedom."""
ROOM = np.array([[0.0, 0.0], [12.0, 0.0], [12.0, 9.0], [0.0, 9.0]])
STEP_S, STEPS, SKIP_S = 0.2, 150, 2.0
ACCELERATION, SPEED = 0.5, 0.7
"""Standard deviations of the velocity that gathers in a second, and of its first value, per axis [m/s]."""
SPEED_OF_SOUND = 343.0
CASES = (("range", 0.05), ("range", 0.5), ("tdoa", 0.05), ("tdoa", 0.5), ("rssi", 2.0), ("rssi", 6.0))
"""Kinds, and standard deviations [m; dB]."""


class Recording(NamedTuple):
    """What is tracked, and the truth."""

    scene: Scene
    table: Measurements
    t_ns: Ints  # (T,)
    xy: Floats  # (T, 2)


def record(kind: str, sigma: float, *, seed: int, false: float = 0.0) -> Recording:
    """A walk with white acceleration in the room, measured by the stations in its corners.

    Args:
        kind: `range`, `tdoa` (differences to the first station) or `rssi`.
        sigma: standard deviation [m; dB].
        seed: of all random numbers.
        false: share of measurements that are uniform: 0 to 20 m, -12 to 12 m, or -90 to -60 dBm.
    """
    rng = np.random.default_rng([seed, 16])
    root = np.linalg.cholesky(ACCELERATION**2 * np.array([[STEP_S**3 / 3, STEP_S**2 / 2], [STEP_S**2 / 2, STEP_S]]))
    while True:
        xy, v = np.empty((STEPS, 2)), SPEED * rng.standard_normal(2)
        xy[0] = rng.uniform([2.0, 2.0], [10.0, 7.0])
        for k in range(1, STEPS):
            moved = root @ rng.standard_normal((2, 2))
            xy[k], v = xy[k - 1] + STEP_S * v + moved[0], v + moved[1]
        if ((xy > ROOM[0]) & (xy < ROOM[2])).all():
            break
    far = np.hypot(*(xy[:, None] - ROOM[None]).transpose(2, 0, 1))
    own = np.arange(1, 4) if kind == "tdoa" else np.arange(4)
    exact = far[:, own] - far[:, :1] if kind == "tdoa" else received_power(-60.0, 2.0, far) if kind == "rssi" else far
    value = exact + sigma * rng.standard_normal(exact.shape)
    low, high = {"range": (0.0, 20.0), "tdoa": (-12.0, 12.0), "rssi": (-90.0, -60.0)}[kind]
    value = np.where(rng.random(value.shape) < false, rng.uniform(low, high, value.shape), value).ravel()
    t_ns = np.round(np.arange(STEPS) * STEP_S * NS).astype(np.int64)
    names = np.array([f"s{n}" for n in own])
    n, nan = len(value), np.full(len(value), np.nan)
    columns = {"range": nan, "sigma_range": nan, "rssi": nan, "sigma_rssi": nan}
    scale = SPEED_OF_SOUND if kind == "tdoa" else 1.0
    columns |= {kind: value / scale, f"sigma_{kind}": np.full(n, sigma / scale)}
    table = Measurements.of(
        t_ns=np.repeat(t_ns, len(own)),
        sensor=np.tile(names, STEPS),
        target_id=np.zeros(n, dtype=np.int32),
        reference=np.full(n, "s0" if kind == "tdoa" else ""),
        **columns,
    )
    arrays = tuple(MicrophoneArray(f"s{n}", np.append(place, 0.0)) for n, place in enumerate(ROOM))
    return Recording(Scene(arrays=arrays, room=ROOM), table, t_ns, xy)


class Outcome(NamedTuple):
    """How one recording was tracked."""

    square: float  # mean square error
    bound: float  # mean square of the bound: of one moment for `fix`, of smoothing for `map`, of filtering for `apf`
    nees: Floats  # (T,)
    flagged: Bools  # (T,) the row says that it is not to be believed as it is: only of `fix`
    squares: Floats  # (T,) square errors [m^2]


def follow(recording: Recording, method: str) -> Outcome:
    """Track by the code of `occlog track`, with the motion that the target has where the method has such a motion."""
    known = (
        {
            "process_noise_velocity": ACCELERATION,
            "process_noise_position": 1e-4,
            "sigma_initial_velocity": SPEED,
        }
        if method == "map"
        else {}
    )
    config = configure(settings_of(method).in_unit("m"), known)
    measured = DistanceMeasurementConfig(propagation_speed="sound")
    feed = DistanceMeasurementFeed([recording.table], recording.scene, measured)
    parts = track([], recording.scene, TrackingTask(config, 0, method=method), None, feed)
    parts = list(parts)
    tracks, doubts = Tracks.concat(p.tracks for p in parts), Diagnostics.concat(p.diagnostics for p in parts)
    settled = tracks.take(tracks.t_ns >= round(SKIP_S * NS))
    flagged = (method == "fix") & (doubts.fallback[tracks.t_ns >= round(SKIP_S * NS)] != "")
    rows = np.searchsorted(recording.t_ns, settled.t_ns)
    away = np.column_stack([settled.x, settled.y]) - recording.xy[rows]
    spread = np.stack([settled.cov_xx, settled.cov_xy, settled.cov_xy, settled.cov_yy], axis=1).reshape(-1, 2, 2)
    squares = np.sum(away**2, axis=1)
    square = float(np.mean(squares))
    nees = normalised_squared_errors(away, spread)
    if method == "fix":
        return Outcome(square, one_moment(recording, rows, measured), nees, flagged, squares)
    n = len(recording.t_ns)
    truth = Truth.of(
        t_ns=recording.t_ns,
        target_id=np.zeros(n, dtype=np.int32),
        x=recording.xy[:, 0],
        y=recording.xy[:, 1],
        z=np.full(n, np.nan),
        role=np.full(n, "target"),
    )
    how = EvaluateConfig(
        motion="cv",
        process_noise_density=ACCELERATION**2,
        sigma_initial_velocity=SPEED,
        settling_s=SKIP_S,
        prior_covariance=(12.0, 0.0, 6.75),
    )
    reported = evaluate(tracks, truth, None, recording.scene, how, measured=(recording.table, measured, None))
    name = "settled_smoothed_bound_rmse_m" if method == "map" else "settled_bound_rmse_m"
    return Outcome(square, reported.metrics[name] ** 2, nees, flagged, squares)


def one_moment(recording: Recording, rows: Ints, config: DistanceMeasurementConfig) -> float:
    """Mean trace of the bounds of moments on their own."""
    row, distances = pack(recording.table, make_stations(recording.scene, config), config)
    at = np.searchsorted(recording.t_ns, recording.table.t_ns[row])
    total = np.zeros((len(recording.t_ns), 2, 2))
    np.add.at(total, at, information(distances, recording.xy[at]))
    assert np.isfinite(residuals_at_own_position(distances, recording.xy[at])[0]).all()
    return float(np.mean(np.trace(np.linalg.inv(total[rows]), axis1=1, axis2=2)))


def run(repeats: int = 5) -> dict[str, Any]:
    """Ratio of the root-mean-square error to the bound over as many seeds as repeats."""
    found = [follow(record("range", 0.05, seed=100 + k), "map") for k in range(repeats)]
    ratio = float(np.sqrt(np.mean([o.square for o in found]) / np.mean([o.bound for o in found])))
    return {
        "ratio": ratio,
        "limit": LIMIT,
        "parts": {"mean NEES": float(np.mean(np.concatenate([o.nees for o in found])))},
    }


def main() -> None:
    """Print a table: a row for each kind and noise, a cell for each method.

    A cell has the RMSE [m], the same over the bound, the mean NEES with its standard error and the share of rows
    outside the ellipse; these two are of rows without a flag.  Where there are flags, their share and the RMSE without
    them follow.
    """
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[100, 101, 102, 103])
    parser.add_argument("--methods", nargs="+", default=["fix", "apf", "map"])
    parser.add_argument("--false", type=float, nargs="+", default=[0.0, 0.1])
    options = parser.parse_args()
    print("| kind | false | " + " | ".join(options.methods) + " |\n" + "|---" * (2 + len(options.methods)) + "|")
    for false in options.false:
        for kind, sigma in CASES:
            cells = []
            for method in options.methods:
                found = [follow(record(kind, sigma, seed=s, false=false), method) for s in options.seeds]
                rmse = float(np.sqrt(np.mean([o.square for o in found])))
                ratio = rmse / float(np.sqrt(np.mean([o.bound for o in found])))
                each = np.array([o.nees[~o.flagged].mean() for o in found])
                error = each.std(ddof=1) / len(each) ** 0.5 if len(each) > 1 else float("nan")
                flagged = np.concatenate([o.flagged for o in found])
                outside = float(np.mean(np.concatenate([o.nees for o in found])[~flagged] > ELLIPSE))
                cells.append(f"{rmse:.3f}, {ratio:.2f}, {each.mean():.2f} +- {error:.2f}, {outside:.0%}")
                if flagged.any():
                    good = float(np.sqrt(np.mean(np.concatenate([o.squares for o in found])[~flagged])))
                    cells[-1] += f"; {flagged.mean():.0%} flagged, without them {good:.3f}, {good * ratio / rmse:.2f}"
            unit = "dB" if kind == "rssi" else "m"
            print(f"| {kind}, {sigma:g} {unit} | {false:.0%} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
