"""One trial of tracking in images: draw a video, track with one or several methods, score against the truth.

A trial is described by plain values.  Several methods share the drawing, which costs as much as one
or two of them.  `alarms` compares the answers of the loop check ([Qu] Sec. 3.4.2) with the trackers'
true distances from their targets.

Where the trackers of some targets in one view are: on their own target, on another, or on none.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats
from occlog.core.metrics.mot.clear_mot import clear_mot
from occlog.core.metrics.mot.failure_rates import failures
from occlog.core.metrics.mot.frame_pairs import Objects, of_boxes
from occlog.core.metrics.mot.hota import hota, identity
from occlog.errors import InputError
from occlog.papers.verdicts import Experiment
from occlog.pipeline.sweep.trial import Spec, Values
from occlog.settings import configure
from occlog.simulate.balls.config import BallsConfig
from occlog.track.methods.images.interface import BAD, GOOD, LEFT, MODES, TERMINATED
from occlog.track.methods.images.methods.config import CONFIGS, MipfConfig

from .staged import Staging, staging_of
from .tracker_runs import DivertedTracker, Runner, TrackerOutput, follow
from .world import births_of, boxes_of, first_frame, geometry_of, of_views


class TrackerPlaces(NamedTuple):
    """Where k trackers of one view are in each of T frames; one that has ended is on none.

    Attributes:
        own: (T, k) within reach of its own target.
        other: (T, k) not on its own, and within reach of another.
        helped: share of the trackers' rows in which another view helped; NaN without rows.
    """

    own: Bools
    other: Bools
    helped: float


def whereabouts(
    truth: Objects, followed: TrackerOutput, tau: Floats, view: int, targets: Sequence[int]
) -> TrackerPlaces:
    """Find where the trackers of some targets in one view are: on their own, on another, or on none.

    Args:
        truth: true boxes, with views, of T frames.
        followed: output of a method.
        tau: (n,) largest distance from a target of a tracker that is on it, for each true box [px].
        view: number of the view.
        targets: k numbers of targets.
    """
    assert truth.view is not None
    frames = int(truth.frame.max()) + 1
    most = int(max(truth.label.max(), followed.target.max(), max(targets))) + 1
    position, reach = np.full((frames, most, 2), np.nan), np.full((frames, most), np.nan)
    rows = truth.view == view
    middle = truth.position[:, :2] + 0.5 * truth.position[:, 2:]
    position[truth.frame[rows], truth.label[rows]], reach[truth.frame[rows], truth.label[rows]] = (
        middle[rows],
        tau[rows],
    )
    tracked = np.full((frames, most, 2), np.nan)
    rows = (followed.view == view) & np.isin(followed.target, list(targets))
    tracked[followed.frame[rows], followed.target[rows]] = followed.ellipse[rows, :2]
    # Distances of the trackers from all targets; comparisons with NaN are false
    away = np.linalg.norm(tracked[:, list(targets), None] - position[:, None], axis=-1)
    near = away <= reach[:, None]
    own = near[:, np.arange(len(targets)), list(targets)]
    modes = followed.mode[rows & (followed.mode >= 0)]
    helped = float(np.mean(modes == MODES.index("bmct"))) if len(modes) else math.nan
    return TrackerPlaces(own, near.any(axis=2) & ~own, helped)


def watched_figures(where: TrackerPlaces) -> dict[str, float]:
    """Figures of some trackers: `helped`, `off`, and `end_own`, `end_other`, `end_none` of the last frame.

    `off`: share of positions that are not on the own target; the last three: shares of the trackers that are on their
    own target, on another and on none.
    """
    own, other = float(where.own[-1].mean()), float(where.other[-1].mean())
    return {
        "helped": where.helped,
        "off": 1.0 - float(where.own.mean()),
        "end_own": own,
        "end_other": other,
        "end_none": 1.0 - own - other,
    }


KEYS = (
    "kind",
    "seed",
    "balls",
    "method",
    "methods",
    "set",
    "fundamental",
    "wrong",
    "use",
    "tau",
    "track_seed",
    "parts",
    "scene",
    "unseen",
    "watched",
)
OWN = ("method", "set", "fundamental", "wrong", "use", "timed", "track_seed", "diverted")
"""Keys of each of `methods`."""
KIND = "qu-views"
WARM = {
    "frames": 8,
    "balls": 3,
    "radius": 12.0,
    "width": 96,
    "height": 96,
    "start_separated": False,
    "background_clutter": 0,
}
"""A video that has everything compiled before anything is timed."""


def alarms(
    truth: Objects, followed: TrackerOutput, tau: Floats, wrong: Sequence[int] | None = None
) -> dict[str, float]:
    """Compare the answers of the loop check with the truth.

    A target is sound in a frame if all its trackers are on it.

    Args:
        truth: true boxes, with views.
        followed: output of a method.
        tau: (n,) largest distance from its target of a tracker that is on it, for each true box [px].
        wrong: (view, target, other) of a tracker that starts on another target, or (view, target, other, frame) of one
            that is put on it before that frame; None: there is none.

    Returns:
        `checked`: share of the rows that were checked; `bad`: share of those that is `bad`; `false_alarm`: of those of
        sound targets, the share that is `bad`; `missed`: of those of the others, the share that is `good`; with
        `wrong`, `noticed`: frames until the tracker is first `bad`, `recovered`: frames until it is on its own target
        for the first time, and `returned`: frames until it is so for good. NaN where there is nothing to divide by;
        inf: never.
    """
    f = followed
    on = on_own(truth, followed, tau)
    sound, later = _sound(f, on), f.mode >= 0
    checked = later & np.isin(f.counterpart, (BAD, GOOD))
    out = {
        "checked": _share(checked, later),
        "bad": _share(checked & (f.counterpart == BAD), checked),
        "false_alarm": _share(checked & sound & (f.counterpart == BAD), checked & sound),
        "missed": _share(checked & ~sound & (f.counterpart == GOOD), checked & ~sound),
    }
    if wrong is not None:
        start = wrong[3] - 1 if len(wrong) > 3 else 0
        own = (f.view == wrong[0]) & (f.target == wrong[1]) & (f.frame > start)
        out["noticed"] = _first(f, own & (f.counterpart == BAD)) - start
        out |= {"recovered": _first(f, own & on) - start, "returned": _for_good(f, own, on) - start}
    return out


def timeline(truth: Objects, followed: TrackerOutput, tau: Floats, parts: int) -> dict[str, float]:
    """Share of the true boxes without their tracker: `off_0`, ... by part of the video, `off_end` of its last frame.

    Args:
        truth: n true boxes, with views.
        followed: output of a method.
        tau: (n,) largest distance from its target of a tracker that is on it [px].
        parts: number of equal parts of the video; one without boxes has NaN.
    """
    f = followed
    last = int(truth.frame.max())
    on = on_own(truth, followed, tau)
    there, all_rows = np.bincount(f.frame[on], minlength=last + 1), np.bincount(truth.frame, minlength=last + 1)
    part = np.arange(last + 1) * parts // (last + 1)
    held, of = np.bincount(part, there, parts), np.bincount(part, all_rows, parts)
    out = {f"off_{k}": 1.0 - float(held[k] / of[k]) if of[k] else math.nan for k in range(parts)}
    return {**out, "off_end": 1.0 - float(there[last] / all_rows[last])}


def on_own(truth: Objects, followed: TrackerOutput, tau: Floats) -> Bools:
    """Mask (m,) of the trackers' rows that are within `tau` of their own target.

    Args:
        truth: n true boxes, with views.
        followed: m rows of trackers.
        tau: (n,) largest distance from a box's middle [px].
    """
    f = followed
    assert truth.view is not None
    index_of = {key: i for i, key in enumerate(zip(truth.frame, truth.view, truth.label, strict=True))}
    rows = np.array([index_of.get(key, -1) for key in zip(f.frame, f.view, f.target, strict=True)], dtype=np.int64)
    middle = truth.position[:, :2] + 0.5 * truth.position[:, 2:]
    away = np.hypot(*(f.ellipse[:, :2] - middle[rows]).T)
    return np.asarray((rows >= 0) & (away <= tau[rows]))


def _sound(followed: TrackerOutput, on: Bools) -> Bools:
    """Mask (m,) of the rows of trackers for targets that all their trackers in the same frame are on.

    `on`: (m,) rows that are on their own target.
    """
    _, cell = np.unique(np.column_stack([followed.frame, followed.target]), axis=0, return_inverse=True)
    off = np.bincount(cell.ravel(), weights=~on)
    return np.asarray(off[cell.ravel()] == 0)


def _share(some: Bools, of: Bools) -> float:
    """Share of the rows `of` that are `some`, by number; NaN if `of` has none."""
    return float(np.sum(some) / np.sum(of)) if of.any() else math.nan


def _first(followed: TrackerOutput, rows: Bools) -> float:
    """First frame among the rows of a mask; inf if it has none."""
    return float(followed.frame[rows].min()) if rows.any() else math.inf


def _for_good(followed: TrackerOutput, rows: Bools, on: Bools) -> float:
    """First frame from which a tracker stays on its target to the end; inf if there is none.

    Args:
        followed: m rows of all trackers.
        rows: (m,) mask of this tracker.
        on: (m,) mask of rows that are on their own target.
    """
    frames, held = followed.frame[rows], on[rows]
    off = frames[~held]
    after = frames[frames > off.max()] if len(off) else frames
    return float(after.min()) if len(after) else math.inf


def views_spec(seed: int, methods: Mapping[str, Values], balls: Values, **more: object) -> Spec:
    """Specification of a trial of several methods for `run_views_trial`.

    Args:
        seed: seed of the video and of the trackers.
        methods: values of each method by label.
        balls: settings of the video.
        **more: further values of the trial.
    """
    return {
        "kind": KIND,
        "seed": seed,
        "balls": dict(balls),
        "methods": {k: dict(m) for k, m in methods.items()},
        **more,
    }


def run_views_trial(spec: Spec) -> dict[str, float]:
    """Draw one video, run one or several methods on it, and score them against the truth.

    Args:
        spec: `seed` of the video, and of the trackers where they have no `track_seed`; `balls` (fields of
            `BallsConfig`; `views` may be a number); `tau` (factor of a target's radius within which a tracker is on it,
            default 1). One method: `method` (a name of `CONFIGS`), `set` (its settings), `fundamental` (kind, or [kind,
            amount], of `geometry_of`), `wrong` ([view, target, other]: there the tracker of `target` starts on `other`;
            with a frame behind, the two are exchanged in that), `use` (the first this many views only), `diverted`
            (fields of `DivertedTracker`), `timed` (also `local_ms`, `interaction_ms`, `collaboration_ms` and `step_ms`:
            means of CPU time a frame). Several: `methods`, these keys by label. `parts`: also `off_0`, ... of
            `timeline`. `scene`: one of `SCENES`. `unseen`: targets that the first view does not see. `watched`: view
            and targets by name; also `name_off`, ... of `watched_figures`.

    Returns:
        For one method, and for each of several as `label.figure`: `fr_p`, `fr_l` ([Qu] Eq. 9), `idf1`, `hota`, `mota`
        (boxes about the ellipses, IoU 0.5), `track_seconds` and `frame_ms` (CPU of the steps, median of a frame;
        without drawing), `particles` (the setting), `ess` (median), `left` and `lost` (trackers that ended so),
        `mode_mipf`, ... (shares of the rows), and those of `alarms`.

    Raises:
        InputError, UsageError: values that do not fit.
    """
    _check(spec, KEYS)
    config, single = configure(BallsConfig(), spec.get("balls", {})), "methods" not in spec
    described = {"": {k: spec[k] for k in OWN if k in spec}} if single else spec["methods"]
    runners = {label: runner_of(config, spec, own) for label, own in described.items()}
    for own in described.values():
        warm(str(own["method"]))
    done, truth, radius = follow(config, int(spec["seed"]), runners, staging=_staging(spec))
    out: dict[str, float] = {}
    for label, followed in done.items():
        true, reach = of_views(truth, float(spec.get("tau", 1.0)) * radius, runners[label].use)
        figures = scores(true, followed, reach)
        figures |= {"particles": float(runners[label].config.particles)}
        figures |= alarms(true, followed, reach, described[label].get("wrong"))
        if len(followed.parts):
            names = ("local_ms", "interaction_ms", "collaboration_ms", "step_ms")
            times = [*followed.parts.mean(axis=0).tolist(), float(followed.seconds.mean())]
            figures |= {name: 1e3 * seconds for name, seconds in zip(names, times, strict=True)}
        if spec.get("parts"):
            figures |= timeline(true, followed, reach, int(spec["parts"]))
        for name, (view, targets) in spec.get("watched", {}).items():
            seen = watched_figures(whereabouts(true, followed, reach, int(view), targets))
            figures |= {f"{name}_{figure}": value for figure, value in seen.items()}
        out |= {f"{label}.{name}" if not single else name: value for name, value in figures.items()}
    return out


views_experiment = functools.partial(Experiment, runs=12, steps=400, trial=run_views_trial)
"""Experiment on videos that trials draw, by default twelve of them with 400 frames."""


def defaults_of(method: str) -> MipfConfig:
    """Default settings of the method with this name; InputError if it is unknown."""
    if method not in CONFIGS:
        raise InputError(
            f"trial: no method {method!r} that tracks in images; there are: {', '.join(CONFIGS)}", id="unknown-name"
        )
    return CONFIGS[method]()


def runner_of(config: BallsConfig, spec: Spec, own: Values) -> Runner:
    """One method of a trial, ready to run.

    Args:
        config: settings of the video.
        spec: specification of the trial.
        own: values of the method in it.

    Raises:
        InputError, UsageError: values that do not fit.
    """
    _check(own, OWN)
    settings = configure(defaults_of(str(own.get("method"))), dict(own.get("set", {})))
    matrices = own.get("fundamental", "true")
    kind, amount = (matrices, 0.0) if isinstance(matrices, str) else matrices
    use = int(own.get("use", config.views))
    if not 1 <= use <= config.views:
        raise InputError(f"trial: use is {use}, must be 1 to {config.views}, the number of views", id="invalid-setting")
    wrong = tuple(own.get("wrong", ()))
    births = births_of(first_frame(config, int(spec["seed"]), _staging(spec)), use, wrong if len(wrong) == 3 else None)
    seed = own.get("track_seed", spec.get("track_seed", spec["seed"]))
    geometry = geometry_of(config, use, kind, float(amount))
    exchange = (int(wrong[0]), int(wrong[1]), int(wrong[2]), int(wrong[3])) if len(wrong) == 4 else None
    return Runner(
        config=settings,
        geometry=geometry,
        births=births,
        seed=int(seed),
        use=use,
        exchange=exchange,
        timed=bool(own.get("timed")),
        diverted=DivertedTracker(**own["diverted"]) if "diverted" in own else None,
    )


def _staging(spec: Spec) -> Staging:
    """Scene and unseen balls that the specification states; InputError for an unknown scene."""
    return staging_of(str(spec.get("scene", "")), tuple(spec.get("unseen", ())))


def _check(spec: Spec, keys: tuple[str, ...]) -> None:
    """Raise InputError if `spec` has a key that is none of `keys`, or lacks a seed where one is due."""
    for key in spec:
        if key not in keys:
            raise InputError(f"trial: unknown key {key!r}; it has: {', '.join(keys)}", id="unknown-key")
    if "seed" in keys and "seed" not in spec:
        raise InputError("trial: seed is missing", id="missing-value")


@functools.lru_cache(maxsize=32)
def warm(method: str) -> None:
    """Run a method on a few small frames, so that nothing is compiled while a trial is timed."""
    config = configure(BallsConfig(), WARM)
    births, geometry = births_of(first_frame(config, 0), 2), geometry_of(config, 2)
    runner = Runner(config=defaults_of(method), geometry=geometry, births=births, seed=0, use=2)
    follow(config, 0, {method: runner})


def scores(truth: Objects, followed: TrackerOutput, tau: Floats) -> dict[str, float]:
    """Figures of a method's output against the truth, and of its cost.

    Args:
        truth: true boxes, with views.
        followed: output of the method.
        tau: (n,) largest distance from its target of a tracker that is on it, for each true box [px].

    Returns:
        `fr_p`, `fr_l`: rates of false positions and false labels ([Qu] Eq. 9); `idf1`, `hota`, `mota`, of boxes around
        the ellipses; `left`, `lost`: trackers that ended so; `track_seconds`, `frame_ms`: CPU time in total, and its
        median over frames; `ess`: median effective sample size; `mode_mipf`, ...: share of rows by mode.
    """
    f = followed
    position = truth.position[:, :2] + 0.5 * truth.position[:, 2:]
    failed = failures(truth._replace(position=position), Objects(f.frame, f.target, f.ellipse[:, :2], f.view), tau)
    boxes = of_boxes(truth, Objects(f.frame, f.target, boxes_of(f.ellipse), f.view))
    modes = {f"mode_{name}": float(np.mean(f.mode[f.mode >= 0] == k)) for k, name in enumerate(MODES)}
    return {
        "fr_p": failed.fr_p,
        "fr_l": failed.fr_l,
        "idf1": identity(boxes).idf1,
        "hota": hota(boxes).means()["hota"],
        "mota": clear_mot(boxes).mota,
        "left": float(np.sum(f.event == LEFT)),
        "lost": float(np.sum(f.event == TERMINATED)),
        "track_seconds": float(np.sum(f.seconds)),
        "frame_ms": 1e3 * float(np.median(f.seconds)),
        "ess": float(np.nanmedian(f.ess)) if np.isfinite(f.ess).any() else math.nan,
        **modes,
    }
