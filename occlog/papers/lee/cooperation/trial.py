"""One run in an environment of [Lee] Ch. 3: a filter that asks cameras by a policy, its errors and its cost.

As in the thesis, the targets in a sensor's range are known: a track begins with the target's true
state when the sensor first hears it, and ends when the target has left the range.  (The thesis states
that initial states are known; how the filter without cameras starts tracks of later targets it does
not state.)  Trials differ in the policy, the association, and the noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.core.numerics.seeds import RandomStream, generator
from occlog.papers.verdicts import Size
from occlog.pipeline.sweep.trial import Spec
from occlog.scans.grouping import BearingRows, scans_of
from occlog.settings import configure
from occlog.track.methods.imm.camera_requests import (
    CAUSES,
    CameraRequest,
    CameraRequests,
    RequestMemory,
    apply_answer,
    other_targets,
    requests_after_scan,
)
from occlog.track.methods.imm.config import ImmConfig
from occlog.track.methods.imm.filter import ArrayScans, ImmState, ImmStepResult, init, step
from occlog.track.methods.imm.tracks import confirmed_track

from .environments import Environment, environment
from .projected_places import PROJECTIONS, relocated

BIN = 50
"""Steps over which a share of requests is taken."""
START_SIGMA, START_SIGMA_V = 0.1, 0.01
"""Deviation of a track's start from the true position [m] and velocity [m/s]."""
FIELD_ALPHA, ROOM_ALPHA = 0.01, 0.2
THESIS = {
    "association": "any",
    "birth_probability": 0.0,
    "camera_fix": "replace",
    "particles": 500,
    "min_request_interval_s": 0.0,
    "max_coasting_s": 1e6,
    "mean_sound_s": 10.0,
    "mean_silence_s": 5.0,
}
"""Settings of the thesis' filter, with its weights corrected (Eqs. 3.7 to 3.11 as printed are no mean of x)."""
FORMS: dict[str, dict[str, object]] = {
    "thesis": THESIS,
    "joint": {**THESIS, "association": "joint", "camera_fix": "update", "model_sojourn_s": 50.0},
}
OUTSIDE = {
    "turn_acceleration": FIELD_ALPHA,
    "process_noise_velocity": 0.01,
    "sigma_initial_velocity": 0.2,
    "max_frame_age_s": 0.5,
}
SCENES: dict[str, Mapping[str, object]] = {
    **dict.fromkeys(("open", "field", "pair"), OUTSIDE),
    "room": {
        "turn_acceleration": ROOM_ALPHA,
        "process_noise_velocity": 0.1,
        "sigma_initial_velocity": 0.3,
        "max_frame_age_s": 0.2,
    },
}
"""Motion models: the manoeuvres' acceleration alpha, and a noise of the velocity of alpha a second (room: half)."""


class FilterOutput(NamedTuple):
    """Estimates and camera requests of one array's filter at T steps, for K targets.

    Positions (T, K, 2) [m], NaN without a track; `asked` (T,) is 1 at steps with a request; all requests with answers.
    """

    xy: Floats  # (T, K, 2) [m]; NaN: no track
    asked: Floats  # (T,) 1 where cameras were asked, else 0
    requests: list[CameraRequest]


def cooperation_spec(
    size: Size,
    run: int,
    scene: str,
    form: str,
    array: int = 0,
    answer: bool = True,
    variance: float | None = None,
    projection: str = "",
    **settings: Any,
) -> Spec:
    """Specification of a trial for `cooperation_trial`.

    Args:
        size: steps, and the seed of all runs.
        run: number of the run.
        scene: `open`, `field`, `pair` or `room`.
        form: form of the filter, a key of `FORMS`.
        array: index of the scene's array that the filter listens to.
        answer: whether answers of cameras are used; they are asked in any case.
        variance: variance of the arrays' noise [deg^2]; None: that of the scene.
        projection: key of `PROJECTIONS`: how cameras find positions; empty: where their lines of sight intersect.
        settings: fields of `ImmConfig`.
    """
    return {
        "scene": scene,
        "form": form,
        "array": array,
        "settings": settings,
        "steps": size.steps,
        "seed": size.seed,
        "run": run,
        "answer": answer,
        "variance": variance,
        "projection": projection,
    }


def cooperation_trial(spec: Spec) -> dict[str, float]:
    """Run the filter of one array with cameras in an environment; return its errors and its cost.

    Args:
        spec: specification from `cooperation_spec`.

    Returns:
        `rmse_K` of each target while it is heard, their mean `rmse`, `requests`, `frames`,
        `fixes` (positions found), `period` (mean steps between fixes of a target), `asked_CAUSE`
        (requests of each cause), `alone_CAUSE` (those of no other cause), `final_K` (error at the
        last step, of those heard then) and `share_N` (share of the steps of the N-th `BIN` in
        which cameras were asked).
    """
    made = environment(spec["scene"], spec["seed"], spec["run"], spec["variance"])
    output = follow(made, spec)
    heard = made.heard[spec["array"], : len(output.xy)] > 0
    error2 = ((output.xy - made.truth.xyz[: len(output.xy), :, :2]) ** 2).sum(axis=2)
    out = {}
    for k, number in enumerate(made.truth.ids.tolist()):
        rows = heard[:, k] & np.isfinite(error2[:, k])
        out[f"rmse_{number}"] = float(np.sqrt(error2[rows, k].mean())) if rows.any() else float("nan")
        out[f"final_{number}"] = float(np.sqrt(error2[-1, k])) if heard[-1, k] else float("nan")
    fixes = sum(r.answer.position is not None for r in output.requests)
    shares = {
        f"share_{n}": float(output.asked[n * BIN : (n + 1) * BIN].mean()) for n in range(len(output.asked) // BIN)
    }
    errors = [v for k, v in out.items() if k.startswith("rmse") and v == v]
    return {
        "rmse": float(np.mean(errors)) if errors else float("nan"),
        **out,
        **shares,
        "requests": float(sum("shared" not in r.answer.ask.causes for r in output.requests)),
        "frames": float(sum(r.frames for r in output.requests)),
        "fixes": float(fixes),
        "period": float(heard.sum()) / fixes if fixes else float("nan"),
        **{f"asked_{c}": float(sum(c in r.answer.ask.causes for r in output.requests)) for c in CAUSES},
        **{f"alone_{c}": float(sum(set(r.answer.ask.causes) == {c} for r in output.requests)) for c in CAUSES},
    }


def follow(made: Environment, spec: Spec) -> FilterOutput:
    """Run the filter of one array with cameras over all steps; return its estimates and requests.

    Args:
        made: environment.
        spec: specification from `cooperation_spec`.
    """
    values = {**SCENES[spec["scene"]], **FORMS[spec["form"]], **spec["settings"]}
    config: ImmConfig = configure(ImmConfig(), values)
    scene, array = made.scene, spec["array"]
    use = BearingRows(frozenset({scene.arrays[array].name, *(c.name for c in scene.cameras)}))
    rng, helping = (
        generator(spec["seed"], RandomStream.TRACK, array, run=spec["run"]),
        generator(spec["seed"], RandomStream.COOPERATE, array, run=spec["run"]),
    )
    T, K = min(spec["steps"], len(made.truth.t_ns)), made.truth.xyz.shape[1]
    out = FilterOutput(np.full((T, K, 2), np.nan), np.zeros(T), [])
    state, memory = init(scene, config, rng), RequestMemory()
    listener, desk = ArrayScans(scene, 1e6), CameraRequests(scene, config)
    index_of = {int(t): n for n, t in enumerate(made.truth.t_ns[:T].tolist())}
    for scan in scans_of([made.bearings], scene, use):
        if scan.t_ns > made.truth.t_ns[T - 1]:
            break
        desk.put(scan)
        for sounds in listener.scans(scan):
            t_ns = sounds.t_ns
            n = index_of[min(index_of, key=lambda t: abs(t - t_ns))] if t_ns not in index_of else index_of[t_ns]
            state, report = step(state, sounds, rng)
            asked, memory = requests_after_scan(state, report, memory, helping)
            # Requests for new tracks (numbers below 0) are dropped: the roster starts all tracks.
            asked = [a for a in asked if a.number >= 0]
            answers = desk.ask(asked, other_targets(state, report, asked), t_ns)
            if spec["projection"]:
                answers = [relocated(a, scene, PROJECTIONS[spec["projection"]]) for a in answers]
            out.requests.extend(answers)
            out.asked[n] = float(bool(asked))
            if spec["answer"]:
                state, report, memory = apply_answer(state, report, [a.answer for a in answers], memory, helping)
            state = _roster(state, made, config, array, n, rng)
            _note(out, report, made, n)
    return out


def _roster(
    state: ImmState, made: Environment, config: ImmConfig, array: int, n: int, rng: np.random.Generator
) -> ImmState:
    """State with tracks of targets heard for the first time added, and without those no longer heard.

    New tracks start near the true state.

    Args:
        state: state of the filter.
        made: environment.
        config: settings of the filter.
        array: index of the array.
        n: number of the step.
        rng: random generator of new particles.
    """
    heard, ids = made.heard[array] > 0, made.truth.ids.tolist()
    there = {t.number for t in state.tracks}
    tracks = [t for t in state.tracks if heard[n:, ids.index(t.number)].any()]
    for k, number in enumerate(ids):
        if number not in there and heard[n, k] and not heard[:n, k].any():
            at, before = made.truth.xyz[n, k, :2], made.truth.xyz[max(n - 1, 0), k, :2]
            after = made.truth.xyz[n + 1, k, :2]
            seconds = float(made.truth.t_ns[n + 1] - made.truth.t_ns[max(n - 1, 0)]) * 1e-9
            v = (after - before) / seconds
            start = (at[0], at[1], START_SIGMA, v[0], v[1], START_SIGMA_V)
            track = confirmed_track(config, number, start, int(made.truth.t_ns[n]), rng)
            tracks.append(track._replace(label=number))
    return state._replace(tracks=tuple(sorted(tracks, key=lambda t: t.number)))


def _note(out: FilterOutput, report: ImmStepResult, made: Environment, n: int) -> None:
    ids = made.truth.ids.tolist()
    for belief in report.beliefs:
        out.xy[n, ids.index(belief.number)] = belief.estimate.mean[::2]
