"""One trial: simulate a scene, measure, track and compare with the truth, all in memory.

A trial is described by plain values, so that it can be stored, hashed and sent
to another process.  Trials of equal seed and run see the same world and the same
measurement noise, whatever else differs.
"""

from __future__ import annotations

import functools
import time
from collections import Counter
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError
from occlog.io.formats.scenes.scene import scene_from_yaml
from occlog.measure.priors.from_positions import virtual_priors
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Diagnostics, Occluders, Tracks, Truth
from occlog.scans.grouping import choose_sensors
from occlog.scans.occluder_priors import known_positions
from occlog.settings import configure
from occlog.simulate.config import ObserveConfig, WorldConfig
from occlog.simulate.sensors.cameras import observe
from occlog.simulate.stage import simulate_truth
from occlog.track.catalogue import settings_of
from occlog.track.drivers.rows import NetworkTraffic
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.methods.apf.config import read_selection

Values = Mapping[str, Any]
"""Plain values by name, as JSON and YAML have them."""
Spec = Values
"""Description of a trial by plain values (as JSON has them), so that any process can run and store it."""
Frozen = tuple[tuple[str, object], ...]
"""Values by name that can be a key of a cache."""
PRIORS = ("none", "known", "kalman")
KEYS = ("scene", "seed", "run", "simulate", "observe", "priors", "track", "cameras", "select", "skip")
WORLDS = 2
"""Number of simulated worlds that are kept, since neighbouring trials share them."""


class SimulatedWorld(NamedTuple):
    """Simulated truth and bearings of a trial; they do not depend on the tracker."""

    truth: Truth
    bearings: Bearings


def run_trial(spec: Spec) -> dict[str, float]:
    """Run one trial: simulate a scene, track a target, and compare with the truth; return figures by name.

    Args:
        spec: `scene` (YAML text), `seed`, `run`; optional `simulate` (fields of `WorldConfig`), `observe` (of
            `ObserveConfig`), `priors` (`kind` none, known or kalman, with `measurement_noise` and
            `process_noise_velocity` for kalman), `track` (`method` and its settings), `cameras` (names of those to
            use), `select` (fields of `SelectConfig`), `skip` (number of estimates skipped at the start).

    Returns:
        `rmse`, `mean_error`, `max_error` (length unit), `lost` (share of estimates more than a fifth of the room away),
        `estimates`, `rmse_occ` (of the priors' means; NaN without priors), `mean_ess`, `sir` and `restart` (scans with
        that fallback), `messages`, `bytes`, `predicted_mse` (mean; NaN without selection), and `track_seconds`
        (processor time; differs from run to run).

    Raises:
        InputError, UsageError: invalid values.
    """
    _check(spec)
    scene = _scene(spec["scene"])
    seed = _seed(int(spec["seed"]), int(spec.get("run", 0)))
    simulate, measured = _frozen(spec.get("simulate", {})), _frozen(spec.get("observe", {}))
    world = _world(spec["scene"], simulate, measured, seed)
    occluders = _priors(spec.get("priors", {"kind": "none"}), world.truth, seed)
    settings = dict(spec.get("track", {}))
    method = settings.pop("method", "apf")
    config = configure(settings_of(method).in_unit(scene.length_unit), settings)
    select = None if spec.get("select") is None else read_selection(spec["select"])
    chosen = choose_sensors(scene, spec.get("cameras") or ())
    start = time.process_time()
    tracking = TrackingTask(config, seed, method=method, sensors=chosen, selection=select)
    parts = list(track([world.bearings], scene, tracking, None if occluders is None else [occluders]))
    seconds = time.process_time() - start
    tracks, diagnostics = Tracks.concat([p.tracks for p in parts]), Diagnostics.concat([p.diagnostics for p in parts])
    figures = errors_of(tracks, world.truth, scene, int(spec.get("skip", 0)))
    figures["rmse_occ"] = rmse_of_priors(occluders, world.truth)
    return figures | _filter_figures(diagnostics) | {"track_seconds": seconds}


def _check(spec: Spec) -> None:
    for key in spec:
        if key not in KEYS:
            raise InputError(f"trial: unknown key {key!r}; it has: {', '.join(KEYS)}", id="unknown-key")
    for key in ("scene", "seed"):
        if key not in spec:
            raise InputError(f"trial: {key} is missing", id="missing-value")


def _seed(seed: int, run: int) -> int:
    """Return the seed of the run with this number, derived from the common seed of all runs."""
    return int(np.random.SeedSequence(seed, spawn_key=(run,)).generate_state(1, np.uint32)[0])


@functools.lru_cache(maxsize=4)
def _scene(text: str) -> Scene:
    return scene_from_yaml(text, "scene")


def _frozen(values: Values) -> Frozen:
    return tuple(sorted(values.items()))


@functools.lru_cache(maxsize=WORLDS)
def _world(text: str, simulate: Frozen, measured: Frozen, seed: int) -> SimulatedWorld:
    scene = _scene(text)
    config: WorldConfig = configure(WorldConfig.in_unit(scene.length_unit), dict(simulate))
    observation: ObserveConfig = configure(ObserveConfig(diameter=config.diameter), dict(measured))
    truth = Truth.concat(list(simulate_truth(scene, config, seed)))
    return SimulatedWorld(truth, Bearings.concat(list(observe(scene, [truth], observation, seed))))


def _priors(values: Values, truth: Truth, seed: int) -> Occluders | None:
    kind = values.get("kind", "none")
    if kind not in PRIORS:
        raise InputError(f"trial: priors.kind is {kind!r}, must be one of {', '.join(PRIORS)}", id="unknown-name")
    if kind == "none":
        return None
    if kind == "known":
        return Occluders.concat(list(known_positions([truth])))
    sigma, q = float(values.get("measurement_noise", 8.0)), float(values.get("process_noise_velocity", 1.2))
    return Occluders.concat(list(virtual_priors([truth], sigma, q, seed)))


def rmse_of_priors(occluders: Occluders | None, truth: Truth) -> float:
    """Return the RMS distance of the priors' means from the true positions of the moving occluders.

    NaN without priors, or if the numbers of rows differ.
    """
    if occluders is None or not len(occluders):
        return float("nan")
    true = truth.take(truth.role == "occluder")
    order = np.lexsort((true.target_id, true.t_ns))
    mine = occluders.take(occluders.occluder_id >= 0)
    own = np.lexsort((mine.occluder_id, mine.t_ns))
    if len(order) != len(own) or not len(own):
        return float("nan")
    dx, dy = mine.x[own] - true.x[order], mine.y[own] - true.y[order]
    return float(np.sqrt(np.mean(dx**2 + dy**2)))


def errors_of(tracks: Tracks, truth: Truth, scene: Scene, skip: int) -> dict[str, float]:
    """Return RMSE, mean and largest error of the estimates of target 0, by name, without the first `skip` estimates.

    Also `lost`, the share of errors above a fifth of the diagonal of the scene's surroundings, and the number of
    estimates. InputError if no estimate is left, or for estimates at times that the truth does not have.
    """
    true = truth.take(truth.target_id == 0)
    own = tracks.take(tracks.target_id == 0)
    index = np.searchsorted(true.t_ns, own.t_ns)
    if np.any(index >= len(true)) or not np.array_equal(true.t_ns[index], own.t_ns):
        raise InputError(
            "trial: estimates are at times that the truth does not have; leave rate_hz of cameras out of the scene",
            id="disjoint-inputs",
        )
    error = np.hypot(own.x - true.x[index], own.y - true.y[index])[skip:]
    if not len(error):
        raise InputError(
            f"trial: skip is {skip}, but there are {len(own)} estimates; skip fewer", id="insufficient-data"
        )
    far = 0.2 * float(np.hypot(*np.ptp(scene.surroundings, axis=0)))
    return {
        "rmse": float(np.sqrt(np.mean(error**2))),
        "mean_error": float(error.mean()),
        "max_error": float(error.max()),
        "lost": float(np.mean(error > far)),
        "estimates": float(len(error)),
    }


def _filter_figures(diagnostics: Diagnostics) -> dict[str, float]:
    fallbacks = Counter(diagnostics.fallback.tolist())
    messages = NetworkTraffic()
    messages.add(diagnostics)
    mse: Floats = diagnostics.predicted_mse[np.isfinite(diagnostics.predicted_mse)]
    return {
        "mean_ess": float(diagnostics.ess.mean()),
        "sir": float(fallbacks["sir"]),
        "restart": float(fallbacks["restart"]),
        "messages": float(messages.reports + messages.orders),
        "bytes": float(messages.bytes),
        "predicted_mse": float(mse.mean()) if len(mse) else float("nan"),
    }
