"""Quality of the loop check of [Qu] Sec. 3.4.2: its answers against the trackers' true distances from their targets."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from occlog.array_types import Bools, Floats
from occlog.core.metrics.frame_pairs import Objects
from occlog.track.images.interface import BAD, GOOD

from .follow import Followed


def alarms(truth: Objects, followed: Followed, tau: Floats, wrong: Sequence[int] | None = None) -> dict[str, float]:
    """Compare the answers of the loop check with the truth.

    A target is sound in a frame if all its trackers are on it.

    Args:
        truth: boxes by view and frame.
        followed: output of a method.
        tau: (n,) largest distance of a tracker on its target, for each true row [px].
        wrong: (view, target, other) of a tracker that starts on another target, or (view, target, other, frame)
            of one that is put on it before that frame.

    Returns:
        `checked`: share of the rows that were checked; `bad`: share of those that is `bad`; `false_alarm`: of those
        of sound targets, the share that is `bad`; `missed`: of those of the others, the share that is `good`; with
        `wrong`, `noticed`: frames until the tracker is first `bad`, `recovered`: frames until it is on its own
        target for the first time, and `returned`: frames until it is so for good.  NaN where there is nothing to
        divide by; inf: never.
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


def timeline(truth: Objects, followed: Followed, tau: Floats, parts: int) -> dict[str, float]:
    """Return the share of true rows without their tracker: `off_0`, ... of the video's parts, `off_end` of its end."""
    f = followed
    last = int(truth.frame.max())
    on = on_own(truth, followed, tau)
    there, all_rows = np.bincount(f.frame[on], minlength=last + 1), np.bincount(truth.frame, minlength=last + 1)
    part = np.arange(last + 1) * parts // (last + 1)
    held, of = np.bincount(part, there, parts), np.bincount(part, all_rows, parts)
    out = {f"off_{k}": 1.0 - float(held[k] / of[k]) if of[k] else math.nan for k in range(parts)}
    return {**out, "off_end": 1.0 - float(there[last] / all_rows[last])}


def on_own(truth: Objects, followed: Followed, tau: Floats) -> Bools:
    """Return (n,) whether each tracker is within tau of its own target."""
    f = followed
    assert truth.view is not None
    place = {key: i for i, key in enumerate(zip(truth.frame, truth.view, truth.label, strict=True))}
    rows = np.array([place.get(key, -1) for key in zip(f.frame, f.view, f.target, strict=True)], dtype=np.int64)
    middle = truth.place[:, :2] + 0.5 * truth.place[:, 2:]
    away = np.hypot(*(f.ellipse[:, :2] - middle[rows]).T)
    return np.asarray((rows >= 0) & (away <= tau[rows]))


def _sound(followed: Followed, on: Bools) -> Bools:
    """Return (n,) whether all trackers of the row's target in its frame are on it."""
    _, cell = np.unique(np.column_stack([followed.frame, followed.target]), axis=0, return_inverse=True)
    off = np.bincount(cell.ravel(), weights=~on)
    return np.asarray(off[cell.ravel()] == 0)


def _share(some: Bools, of: Bools) -> float:
    return float(np.sum(some) / np.sum(of)) if of.any() else math.nan


def _first(followed: Followed, rows: Bools) -> float:
    return float(followed.frame[rows].min()) if rows.any() else math.inf


def _for_good(followed: Followed, rows: Bools, on: Bools) -> float:
    """Return the first frame from which a tracker stays on its target to the end; inf: there is none."""
    frames, held = followed.frame[rows], on[rows]
    off = frames[~held]
    after = frames[frames > off.max()] if len(off) else frames
    return float(after.min()) if len(after) else math.inf
