"""[Lee] Figs. 5-20 to 5-23: heads from several angles, distinguished by their colours; decisions that are suspended."""

from __future__ import annotations

import functools
import math

import numpy as np

from occlog.array_types import Bools, Bytes, Floats, Ints
from occlog.core.geometry.camera import rotation_from_angles
from occlog.core.image import bins_of, colour_counts, corrected, density
from occlog.core.metrics.ranking import area_under_curve, rank_one
from occlog.papers import verdicts as v
from occlog.papers.plots import FigureImage, Shots
from occlog.papers.verdicts import Execute, Experiment, PaperRow, Size, StatementVerdict, Table, sample
from occlog.pipeline.sweep.trial import Spec
from occlog.records.scene import Camera
from occlog.simulate.render.body import HAIR, SKIN, WALKING, Clothes
from occlog.simulate.render.frame import Canvas, bare_canvas, draw

PEOPLE = 10
ANGLES = 7
"""N of the full gallery: every 30 degrees from the front to the back."""
LEVELS = {2: 6, 4: 20, 8: 72, 15: 240}
"""Levels of colours, and the numbers m of bins that they make."""
OWN_LEVELS = 8
IMAGE, DISTANCE, FOCAL_PX = (72, 64), 4.0, 560.0
EYES, HEAD = 1.6, 0.25
"""Height at which the camera hangs, and height of a head from its top [m]."""
LIGHTS = np.array([[-1.5, -1.5, 2.7, 0.6, 6.0], [1.5, 1.5, 2.7, 0.4, 6.0]])
GAIN, NOISE = 0.1, (1.5, 1.0)
"""Share by which the light of a candidate differs, and noise of pixels, common and of each colour."""
DIFFERENT, ALIKE = "other skin and hair", "same skin and hair"
KINDS = {"different": DIFFERENT, "alike": ALIKE}
POOLED = "all sides together"
GALLERIES = (1, 2, 4, 7)
"""Numbers N of angles; 1 is the front."""
KNOWN = (1, 2, 4)
"""Number of the seven angles, from the front on, in a gallery with suspended decisions."""
ANYWAY, SUSPENDED, LEFT = "decided anyway", "suspended", "share that is suspended"


def people_of(kind: str, rng: np.random.Generator) -> Clothes:
    """Draw `PEOPLE` people in equal clothes: of different skin and hair (`kind` "different"), else nearly alike."""
    wide = kind == "different"
    tone = rng.uniform(0.35, 1.05, PEOPLE) if wide else 0.85 + rng.uniform(-0.02, 0.02, PEOPLE)
    dark = rng.uniform(0.1, 0.8, PEOPLE) if wide else 0.25 + rng.uniform(-0.02, 0.02, PEOPLE)
    tint = rng.uniform(0.0, 1.0, PEOPLE) if wide else np.full(PEOPLE, 0.5)
    first = np.full((PEOPLE, 5, 3), 90.0)
    first[:, SKIN] = tone[:, None] * np.array([150.0, 178.0, 224.0])
    # From red-brown to blond
    hair = np.array([60.0, 110.0, 255.0]) * (1.0 - tint[:, None]) + np.array([120.0, 215.0, 255.0]) * tint[:, None]
    first[:, HAIR] = dark[:, None] * hair
    return Clothes(first, first, np.zeros((PEOPLE, 5), dtype=np.int64), np.ones(PEOPLE))


def studio() -> Canvas:
    """Canvas of a camera that points along the x axis at the origin, where heads are seen, on black."""
    width, height = IMAGE
    camera = Camera(
        "studio",
        np.array([-DISTANCE, 0.0, EYES]),
        rotation_from_angles(0.0, 0.0, 0.0),
        np.array([FOCAL_PX, FOCAL_PX]),
        np.array([0.5 * (width - 1), 0.5 * (height - 1)]),
        image_size=IMAGE,
    )
    return bare_canvas(camera, LIGHTS, 1.0)


def head_counts(
    canvas: Canvas, people: Clothes, angle: float, rng: np.random.Generator, gain: float, levels: list[int]
) -> list[Floats]:
    """Numbers of pixels (P, m) in each of m colour bins of the heads of P people, for each number of levels.

    Args:
        canvas: canvas of the camera.
        people: clothes of P people.
        angle: viewing angle [rad]; 0 is the front.
        rng: generator of gait phases and image noise.
        gain: factor of the light.
        levels: numbers of levels of each colour channel.
    """
    out: list[list[Ints]] = [[] for _ in levels]
    for k in range(len(people.stature)):
        one = Clothes(*(part[k : k + 1] for part in people))  # type: ignore[arg-type]
        bare = head_image(canvas, one, angle, rng.uniform(0.0, 2.0 * math.pi), gain)
        mask = bare.max(axis=2) > 0
        rows = np.flatnonzero(mask.any(axis=1))
        mask[rows[0] + round(HEAD * FOCAL_PX / DISTANCE) :] = False
        grain = rng.normal(0.0, NOISE[0], (*mask.shape, 1)) + rng.normal(0.0, NOISE[1], bare.shape)
        image = np.clip(np.rint(bare + grain), 0, 255).astype(np.uint8)
        for found, level in zip(out, levels, strict=True):
            found.append(colour_counts(image, mask.astype(np.uint8), level))
    return [np.array(found, dtype=np.float64) for found in out]


def heads(size: Size) -> Shots:
    """Pictures of the heads of four different people at every angle of the gallery."""
    rng = np.random.default_rng(size.seed)
    canvas, people = studio(), people_of("different", rng)
    step = math.pi / (ANGLES - 1)
    rows = []
    for k in range(4):
        one = Clothes(*(part[k : k + 1] for part in people))  # type: ignore[arg-type]
        rows.append(
            tuple(
                FigureImage(
                    f"n = {a + 1}, {180 * a // (ANGLES - 1)} deg",
                    head_image(canvas, one, a * step, 0.0, 1.0),
                    (),
                    (),
                    (),
                )
                for a in range(ANGLES)
            )
        )
    caption = "The colours of each head at each angle are a density of the gallery."
    return Shots("Heads from front to back", caption, tuple(f"person {k}" for k in range(4)), tuple(rows))


def head_image(canvas: Canvas, one: Clothes, angle: float, phase: float, gain: float) -> Bytes:
    """BGR image of one person on black, without noise, in the camera that is directed at heads.

    Args:
        canvas: canvas of the camera.
        one: clothes of the person.
        angle: viewing angle [rad]; 0 is the front.
        phase: phase of the gait [rad].
        gain: factor of the light.
    """
    # The camera is towards -x: who heads there is seen from the front
    heading = math.pi + angle
    row = np.array([[0.0, 0.0, WALKING * math.cos(heading), WALKING * math.sin(heading), phase]])
    return draw(canvas, row, one, gain, (0.0, 0.0), shadows=False, rng=np.random.default_rng(0)).image


def faces_trial(spec: Spec) -> dict[str, float]:
    """Draw all people once for the gallery and `probes` times as candidates, at every angle, and identify these.

    Args:
        spec: `probes`, `seed` and `run`.

    Returns:
        For each kind of people `rank1-KIND-bins-M` and `auc-KIND-bins-M` with all angles, by number M of bins;
        `rank1-KIND-angles-N` and `auc-...` by number N of angles in the gallery (0: all sides together); and by the
        number K of known angles the shares of false decisions `false-KIND-anyway-K` and `false-KIND-suspended-K`,
        and the share `left-KIND-K` of suspended ones.
    """
    run = np.random.SeedSequence(int(spec["seed"]), spawn_key=(int(spec["run"]),))
    canvas, levels, probes = studio(), list(LEVELS), int(spec["probes"])
    out: dict[str, float] = {}
    for kind, seed in zip(KINDS, run.spawn(len(KINDS)), strict=True):
        rng = np.random.default_rng(seed)
        people = people_of(kind, rng)
        step = math.pi / (ANGLES - 1)
        stored = [head_counts(canvas, people, a * step, rng, 1.0, levels) for a in range(ANGLES)]
        seen: list[list[Floats]] = []
        indices: list[int] = []
        for a in range(ANGLES):
            for _ in range(probes):
                # Anywhere in the bin, on either side of the person
                off = rng.uniform(-0.5, 0.5) * step
                angle = rng.choice([-1.0, 1.0]) * abs(a * step + off)
                seen.append(head_counts(canvas, people, angle, rng, 1.0 + rng.uniform(-GAIN, GAIN), levels))
                indices.append(a)
        for i, level in enumerate(levels):
            gallery = np.stack([s[i] for s in stored], axis=1)  # (P, A, m)
            candidates = np.concatenate([s[i] for s in seen])  # (probes, m), person after person
            owner = np.tile(np.arange(PEOPLE), len(seen))
            at = np.repeat(indices, PEOPLE)
            full = similarities(gallery, candidates, at)
            out[f"rank1-{kind}-bins-{bins_of(level)}"] = rank_one(full, owner)
            out[f"auc-{kind}-bins-{bins_of(level)}"] = area_under_curve(full, owner)
            if level == OWN_LEVELS:
                out |= _by_angles(kind, gallery, candidates, owner, at)
                out |= _suspended(kind, gallery, candidates, owner, at)
    return out


def similarities(gallery: Floats, candidates: Floats, angle: Ints) -> Floats:
    """(n, P) bias-corrected Bhattacharyya coefficients of candidates (n, m) with a gallery (P, A, m), colour counts.

    Each candidate is compared at its angle, an index (n,) of the A angles.
    """
    out = np.empty((len(candidates), len(gallery)))
    for a in np.unique(angle).tolist():
        rows, side = angle == a, gallery[:, a]
        own = candidates[rows]
        _, out[rows] = corrected(
            density(own), density(side), own.sum(axis=1).astype(np.int64), side.sum(axis=1).astype(np.int64)
        )
    return out


def _by_angles(kind: str, gallery: Floats, candidates: Floats, owner: Ints, at: Ints) -> dict[str, float]:
    """Rank-1 rates and AUC by number of gallery angles; each candidate is compared with the nearest of them.

    Args:
        kind: kind of people, part of the names of the figures.
        gallery: (P, `ANGLES`, m) colour counts of P people.
        candidates: (n, m) colour counts.
        owner: (n,) person of each candidate.
        at: (n,) index of its angle.
    """
    out = {}
    for n in (0, *GALLERIES):
        if n == 0:
            own, angle = gallery.sum(axis=1, keepdims=True), np.zeros_like(at)
        else:
            kept = np.rint(np.linspace(0, ANGLES - 1, n)).astype(np.int64) if n > 1 else np.zeros(1, dtype=np.int64)
            own, angle = gallery[:, kept], np.abs(at[:, None] - kept[None, :]).argmin(axis=1)
        like = similarities(own, candidates, angle)
        out[f"rank1-{kind}-angles-{n}"] = rank_one(like, owner)
        out[f"auc-{kind}-angles-{n}"] = area_under_curve(like, owner)
    return out


def _suspended(kind: str, gallery: Floats, candidates: Floats, owner: Ints, at: Ints) -> dict[str, float]:
    """Shares of false decisions (is this the person or not) by a partial gallery, with and without suspending.

    The gallery has its first angles only. The threshold gives equal shares of refused right and accepted wrong pairs at
    angles that it has. As many right as wrong pairs count.

    Args:
        kind: key of `KINDS`, in the names of the figures.
        gallery: (P, ANGLES, m) colour counts of P people.
        candidates: (n, m) colour counts to be recognised.
        owner: (n,) index of each candidate's person.
        at: (n,) index of the angle that it was seen at.

    Returns:
        By kind and number of angles that the gallery has: `false-...-anyway`, `false-...-suspended` without the
            candidates at missing angles, and `left-...`, the share of those.
    """
    out = {}
    same = owner[:, None] == np.arange(PEOPLE)
    for known in KNOWN:
        like = similarities(gallery, candidates, np.minimum(at, known - 1))
        there = at < known
        threshold = equal_error(like[there], same[there])
        wrong = (like >= threshold) != same
        # As many right as wrong pairs count
        weight = np.where(same, 1.0 / same.sum(), 1.0 / (~same).sum())
        out[f"false-{kind}-anyway-{known}"] = float((wrong * weight).sum() / weight.sum())
        out[f"false-{kind}-suspended-{known}"] = float((wrong * weight)[there].sum() / weight[there].sum())
        out[f"left-{kind}-{known}"] = float(1.0 - there.mean())
    return out


def equal_error(like: Floats, same: Bools) -> float:
    """Threshold with the most nearly equal shares of right pairs below it and of wrong pairs at or above it.

    Args:
        like: likeness of pairs.
        same: mask of the right ones, of the same shape.
    """
    right, wrong = np.sort(like[same]), np.sort(like[~same])
    levels = np.unique(like)
    missed = np.searchsorted(right, levels) / len(right)
    accepted = 1.0 - np.searchsorted(wrong, levels) / len(wrong)
    return float(levels[np.abs(missed - accepted).argmin()])


def _run(size: Size, execute: Execute) -> list[dict[str, float]]:
    return execute([{"kind": "lee-faces", "probes": size.steps, "seed": size.seed, "run": r} for r in range(size.runs)])


def by_bins(size: Size, execute: Execute) -> Table:
    """Table of rank-1 rate and AUC of the recognition of faces by colour, against the number of histogram bins.

    `size.steps` is the number of candidates of each person and angle.
    """
    found = _run(size, execute)
    return [
        PaperRow(f"{words}, {name}", m, tuple(f[f"{key}-{kind}-bins-{m}"] for f in found))
        for kind, words in KINDS.items()
        for key, name in (("rank1", "rank-1"), ("auc", "AUC"))
        for m in LEVELS.values()
    ]


def by_angles(size: Size, execute: Execute) -> Table:
    """Table of rank-1 rate and AUC of the recognition of faces by colour, against the number of angles in the gallery.

    One histogram of all sides is a line across. `size.steps` is the number of candidates of each person and angle.
    """
    found = _run(size, execute)
    rows = []
    for kind, words in KINDS.items():
        for key, name in (("rank1", "rank-1"), ("auc", "AUC")):
            values = {n: tuple(f[f"{key}-{kind}-angles-{n}"] for f in found) for n in (0, *GALLERIES)}
            rows += [PaperRow(f"{words}, {name}", n, values[n]) for n in GALLERIES]
            rows.append(PaperRow(f"{words}, {name}, {POOLED}", math.nan, values[0]))
    return rows


def by_suspension(size: Size, execute: Execute) -> Table:
    """Table of the share of false decisions on faces against the number of angles, of seven, that the gallery has."""
    found = _run(size, execute)
    rows = []
    for kind, words in KINDS.items():
        for key, name in (("anyway", ANYWAY), ("suspended", SUSPENDED)):
            rows += [PaperRow(f"{words}, {name}", k, tuple(f[f"false-{kind}-{key}-{k}"] for f in found)) for k in KNOWN]
        rows += [
            PaperRow(f"{words}, {LEFT}", k, tuple(f[f"left-{kind}-{k}"] for f in found), plotted=False) for k in KNOWN
        ]
    return rows


def judge_bins(table: Table) -> list[StatementVerdict]:
    """Verdicts on whether faces of different people are separable by colour, and those of similar people less so."""
    out = []
    for name in ("rank-1", "AUC"):
        statement = (
            f"Figs. 5-20 and 5-21: people of one skin and hair are harder to distinguish ({name} lower by this)."
        )
        points = v.matched(table, f"{ALIKE}, {name}", f"{DIFFERENT}, {name}")
        out.append(v.pairs(f"race-{name}", statement, points))
    row = v.find(table, f"{DIFFERENT}, AUC", float(bins_of(OWN_LEVELS)))
    statement = "Fig. 5-20: people of different skin and hair are distinguished by the coefficient; AUC with 72 bins."
    rule = "an AUC of at least .9; in part from .7 on"
    measured = sample(() if row is None else row.values)
    return [*out, v.judge("separable", statement, measured, v.at_least(0.9), v.at_least(0.7), rule=rule)]


def judge_angles(table: Table) -> list[StatementVerdict]:
    """Verdicts on whether several angles are better than one front face, and than all sides together.

    The latter statement is this project's.
    """
    out = []
    for kind, words in KINDS.items():
        for name in ("rank-1", "AUC"):
            rows = v.series(table, f"{words}, {name}")
            pooled = v.find(table, f"{words}, {name}, {POOLED}")
            if not rows or pooled is None:
                continue
            statement = (
                f"Figs. 5-22, 5-23: seven angles are better than the front face alone; {words}: {name} higher by this."
            )
            out.append(v.pairs(f"angles-{kind}-{name}", statement, [(rows[0], rows[-1])]))
            statement = (
                f"Seven angles are better than all sides together (of this project); {words}: {name} higher by this."
            )
            out.append(v.pairs(f"pooled-{kind}-{name}", statement, [(pooled, rows[-1])]))
    return out


def judge_suspension(table: Table) -> list[StatementVerdict]:
    """Verdicts on whether decisions are less often false if suspended until a known side of the face is seen."""
    return [
        v.pairs(
            f"suspend-{kind}",
            f"Suspending until a known side is seen avoids false decisions; {words}: share of them lower by this.",
            v.matched(table, f"{words}, {SUSPENDED}", f"{words}, {ANYWAY}"),
        )
        for kind, words in KINDS.items()
    ]


NOTE = (
    f"Heads of {PEOPLE} drawn people, 500 pixels each, one image of each at {ANGLES} angles in the gallery; candidates "
    f"at any angle of the bin, on either side, in light that differs by up to {GAIN:.0%}. Steps are candidates of each "
    "person and angle."
)
_experiment = functools.partial(Experiment, runs=24, steps=4, quick=(4, 2), trial=faces_trial)
FACES = (
    _experiment(
        item="faces",
        title="Figs. 5-20 and 5-21: people distinguished by colours",
        x_label="number of bins",
        y_label="rank-1, AUC",
        compute=by_bins,
        judge=judge_bins,
        note=NOTE,
    ),
    _experiment(
        item="angles",
        title="Figs. 5-22 and 5-23: faces from several angles",
        x_label="angles in the gallery",
        y_label="rank-1, AUC",
        compute=by_angles,
        judge=judge_angles,
        note=f"{NOTE} One angle is the front.",
        plans={"heads": heads},
    ),
    _experiment(
        item="suspended",
        title="Sec. 5.2.1: decisions that wait for a known side",
        x_label="angles in the gallery, of seven, from the front on",
        y_label="share of false decisions",
        compute=by_suspension,
        judge=judge_suspension,
        note=NOTE,
    ),
)
"""Heads from several angles."""
