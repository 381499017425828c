"""The kit of trackers of one camera: each check tries one promise with boxes of two people who walk."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from occlog.array_types import NS, Floats, Ints
from occlog.plugins.interface import BoxesInFrame
from occlog.track.single_view.stage import fault_of

from .faults import FIRST, BrokenError, Check, bytes_left, called, defaults, manners, named, refuse, step_unchanged

START_NS = 1_790_000_000 * NS
STEP_NS = NS // 25
FRAMES = 40
SETTLED = 10
"""Frame from which a tracker must have confirmed a person."""
GROWTH_BYTES = 300
"""Memory that a frame may leave behind."""


def edges(k: int) -> Floats:
    """Return the boxes (2, 4) of two people in frame `k`: left, top, width and height [px], with noise.

    The people walk side by side, far from each other, to and fro without end.
    """
    rng = np.random.default_rng(k)
    way = float(k % 400) if k % 800 < 400 else 400.0 - k % 400
    boxes = np.array([[100.0 + 2.0 * way, 200.0, 60.0, 160.0], [100.0 + 2.0 * way, 600.0, 70.0, 180.0]])
    return np.asarray(boxes + rng.normal(0.0, 1.0, (2, 4)))


def frame(k: int, boxes: Floats | None = None, *, t_ns: int | None = None) -> BoxesInFrame:
    """Return the boxes of frame `k` of the sample walk, with scores of 0.9 and without embeddings.

    Args:
        k: frame number.
        boxes: (n, 4) left, top, width and height [px]; None: those of the walk.
        t_ns: time [ns]; None: that of the frame at 25 frames per second.
    """
    there = edges(k) if boxes is None else boxes
    return BoxesInFrame(
        t_ns=START_NS + k * STEP_NS if t_ns is None else t_ns,
        frame=k,
        boxes=there.copy(),
        scores=np.full(len(there), 0.9),
        embeddings=np.zeros((len(there), 0), dtype=np.float32),
    )


def start(of: Any, seed: int = 1) -> Any:
    """Return a new tracker of class `of` with its default settings and random numbers of `seed`."""
    with called("a new tracker"):
        return of(defaults(of), np.random.default_rng(seed))


def step(own: Any, found: BoxesInFrame, what: str = "step") -> Ints:
    """Return the identities (n,) that the tracker `own` assigns to the boxes of a frame.

    Args:
        own: the tracker.
        found: boxes of the frame.
        what: words for the call in messages.

    Raises:
        BrokenError: `step` raises, or returns impossible identities.
    """
    with called(what):
        ids = own.step(found)
    refuse(fault_of(ids, len(found.boxes)), "" if what == "step" else what)
    return np.array(ids, dtype=np.int64).reshape(-1)


def run(of: Any, frames: Iterable[BoxesInFrame], what: str = "step") -> list[list[int]]:
    """Run a new tracker of class `of` on frames, and return the identities of the boxes of each frame.

    Args:
        of: class of the tracker.
        frames: in the order of time.
        what: words for the call in messages.

    Raises:
        BrokenError: the tracker raises, or returns impossible identities.
    """
    own = start(of)
    return [step(own, each, what).tolist() for each in frames]


def walk(count: int = FRAMES) -> list[BoxesInFrame]:
    """Return the first `count` frames of the sample walk of two people."""
    return [frame(k) for k in range(count)]


def use(of: Any) -> list[list[int]]:
    """Return the identities that a new tracker of class `of` assigns in the first 15 frames of the sample walk."""
    return run(of, walk(15))


def _renamed(ids: Iterable[Iterable[int]]) -> list[list[int]]:
    """Return identities renumbered from 0 in the order of first use, so that two runs can be compared; below 0: -1.

    `ids`: identities of the boxes of each frame.
    """
    known: dict[int, int] = {}
    return [[-1 if k < 0 else known.setdefault(k, len(known)) for k in each] for each in ids]


def _raw(of: Any, wanted: Callable[[str], bool]) -> None:
    try:
        own = start(of)
        found = [(own.step(each), len(each.boxes)) for each in walk()]
    except Exception:
        return
    for ids, count in found:
        wrong = fault_of(ids, count)
        if wrong is not None and wanted(wrong):
            raise BrokenError(wrong)


def check_shape(of: Any) -> None:
    """Check that `step` returns a whole number for each box."""
    _raw(of, lambda wrong: wrong.startswith("step gives"))


def check_numbers(of: Any) -> None:
    """Check that identities are at least 0, or -1 (none)."""
    _raw(of, lambda wrong: "must be at least 0" in wrong)


def check_once(of: Any) -> None:
    """Check that no identity occurs twice in one frame."""
    _raw(of, lambda wrong: "twice" in wrong)


def check_follows(of: Any) -> None:
    """Check that a person found in every frame has one identity after `SETTLED` frames."""
    late = run(of, walk())[SETTLED:]
    for person in (0, 1):
        own = {ids[person] for ids in late}
        if own == {-1}:
            raise BrokenError(
                f"the tracker gives a person who is in all frames no identity after {SETTLED} of them; give one"
            )
        if len(own) > 1:
            raise BrokenError(
                f"the tracker gives a person who is in all frames {len(own)} identities; one was expected"
            )


def check_apart(of: Any) -> None:
    """Check that two people who are far from each other have different identities."""
    late = run(of, walk())[SETTLED:]
    if {ids[0] for ids in late} & {ids[1] for ids in late} - {-1}:
        raise BrokenError(
            "the tracker gives one identity to two people who are far from each other in all frames; two were expected"
        )


def check_newcomer(of: Any) -> None:
    """Check that a person who enters in frame 20 gets an identity that was not used before."""
    newcomer = np.array([[1500.0, 300.0, 50.0, 150.0]])
    frames = [frame(k, np.concatenate([edges(k), newcomer + 0.5 * k]) if k >= 20 else None) for k in range(FRAMES)]
    ids = run(of, frames)
    before = {k for each in ids[:20] for k in each} - {-1}
    if before & {each[2] for each in ids[20:]}:
        raise BrokenError(
            "the tracker gives a person who enters later an identity that was used before; give a new one"
        )


def check_order(of: Any) -> None:
    """Check that identities do not depend on the order of the boxes."""
    plain = _renamed(run(of, walk()))
    turned = run(of, [each._replace(boxes=each.boxes[:: 1 - each.frame % 2 * 2].copy()) for each in walk()])
    back = _renamed(ids[:: 1 - k % 2 * 2] for k, ids in enumerate(turned))
    if back[SETTLED:] != plain[SETTLED:]:
        raise BrokenError(
            "the tracker gives other identities if the boxes of a frame are in another order; do not use their order"
        )


def check_independent(of: Any) -> None:
    """Check that trackers of several cameras do not influence each other."""
    alone, first, second = run(of, walk(15)), start(of), start(of)
    both = []
    for each in walk(15):
        both.append(step(first, each).tolist())
        step(second, each._replace(boxes=each.boxes + 300.0))
    if _renamed(alone) != _renamed(both):
        raise BrokenError(
            "the tracker's identities depend on another camera's tracker; keep state in the object, not the class"
        )


def check_inputs(of: Any) -> None:
    """Check that `step` leaves the arrays of the given frame unchanged."""
    own = start(of)
    for each in walk(15):
        step_unchanged(step, own, each, "frame")


def check_results(of: Any) -> None:
    """Check that identities which a tracker has returned do not change in later calls."""
    own, kept = start(of), []
    for k in range(15):
        each = frame(k, edges(k)[: 1 + k % 2])
        with called("step"):
            ids = own.step(each)
        kept.append((ids, np.array(ids).tolist()))
    if any(np.array(ids).tolist() != was for ids, was in kept):
        raise BrokenError("the tracker changes identities that it has returned; return copies")


def check_memory(of: Any) -> None:
    """Check that memory does not grow with the length of a recording."""
    own = start(of)
    grown = bytes_left((step(own, frame(n)) for n in range(400)), 200)
    if grown > GROWTH_BYTES:
        raise BrokenError(
            f"the tracker's memory grows by {grown:.0f} bytes each frame (allowed: {GROWTH_BYTES}); keep no history"
        )


def check_empty(of: Any) -> None:
    """Check that a tracker accepts frames without boxes, first ones and later ones."""
    no_boxes = np.zeros((0, 4))
    gone = (0, 1, 8, 9)
    run(of, [frame(k, no_boxes if k in gone else None) for k in range(15)], "frames without a box: step")


def check_crowd(of: Any) -> None:
    """Check that a tracker accepts 60 people who all enter in one frame, and leave in one."""
    rng = np.random.default_rng(2)
    many = np.column_stack([rng.uniform(0, 1900, 60), rng.uniform(0, 1000, 60), np.full(60, 20.0), np.full(60, 50.0)])
    run(of, [*walk(5), *(frame(k, many + k) for k in range(5, 9)), *(frame(k) for k in range(9, 15))], "a crowd: step")


def check_same_box(of: Any) -> None:
    """Check that a tracker accepts a box that a detector reports twice."""
    run(of, [frame(k, edges(k)[[0, 0, 1]]) for k in range(15)], "a box that is there twice: step")


def check_unknown_scores(of: Any) -> None:
    """Check that a tracker accepts NaN as scores."""
    frames = [each._replace(scores=np.full(2, np.nan)) for each in walk(15)]
    run(of, frames, "scores that are NaN: step")


def check_embeddings(of: Any) -> None:
    """Check that a tracker accepts embeddings, with NaN for some boxes."""
    vectors = np.array([[0.6, 0.8, 0.0], [np.nan, np.nan, np.nan]], dtype=np.float32)
    run(of, [each._replace(embeddings=vectors.copy()) for each in walk(15)], "embeddings: step")


def check_gap(of: Any) -> None:
    """Check that a tracker accepts a frame that comes an hour after the previous one."""
    hour = 3600 * NS
    later = [frame(k + 90_000, edges(k), t_ns=START_NS + hour + k * STEP_NS) for k in range(15, 25)]
    run(of, [*walk(15), *later], "an hour without a frame: step")


def check_same_time(of: Any) -> None:
    """Check that a tracker accepts two frames with the same time."""
    run(of, [frame(k, t_ns=START_NS + k // 2 * STEP_NS) for k in range(15)], "two frames of one time: step")


def check_epoch(of: Any) -> None:
    """Check that identities do not depend on the epoch of times, nor on the first frame number."""
    early = [each._replace(t_ns=each.t_ns - START_NS, frame=each.frame + 5000) for each in walk()]
    if _renamed(run(of, early)) != _renamed(run(of, walk())):
        raise BrokenError(
            "the tracker's identities change if all times or frame numbers are shifted; use time differences only"
        )


CHECKS: dict[str, Check] = {
    **FIRST,
    **named(globals()),
    **manners(use, "step"),
}
"""Every check by its name."""
