"""[Lee] Figs. 5-8 and 5-9: how people who move one way seem to move in cameras around them."""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Floats
from occlog.core.geometry.camera import rotation_from_angles
from occlog.measure.appearance.sightings import expected_boxes
from occlog.papers import verdicts as v
from occlog.papers.verdicts import Execute, Experiment, PaperRow, Size, StatementVerdict, Table, sample
from occlog.pipeline.sweep.trial import Spec
from occlog.records.scene import Camera

DISTANCE, HEIGHT, PERSON = 8.0, 2.0, 1.7
"""Distance of the cameras from the middle, their height, and the height of a person [m]."""
PLACES = {1: (180.0, 1.5), 2: (180.0, -1.5), 3: (270.0, 0.0), 4: (0.0, 0.0), 5: (90.0, 0.0)}
"""Cameras: the side of the middle of each [deg from east], and how far from it [m].  They are from
the statements: who walks north moves to the left in cameras that point east."""
DIRECTIONS = {"N": 90.0, "S": 270.0, "W": 180.0, "E": 0.0, "NE": 45.0, "SE": -45.0, "NW": 135.0, "SW": 225.0}
SIDEWAYS = {"left": -1, "right": 1, "": 0}
GROWTH = {"smaller": -1, "bigger": 1, "": 0}
PRINTED = {
    "N": {1: ("left", ""), 2: ("left", ""), 3: ("", "smaller"), 4: ("right", ""), 5: ("", "bigger")},
    "NE": {
        1: ("left", "smaller"),
        2: ("left", "smaller"),
        3: ("right", "smaller"),
        4: ("right", "bigger"),
        5: ("left", "bigger"),
    },
}
"""Movement and change of size in the image by the text; empty: not stated."""
STEP, AROUND = 0.5, 0.5
"""Way between two frames, and how far from the middle people start [m]."""
STILL = 0.25
"""A change is seen if it is above this share of the greatest one of a camera that sees it fully."""


def camera_of(number: int) -> Camera:
    """Camera with this number, directed horizontally towards the room's middle from its side."""
    side, lateral = PLACES[number]
    angle = math.radians(side)
    out, across = np.array([math.cos(angle), math.sin(angle)]), np.array([-math.sin(angle), math.cos(angle)])
    position = DISTANCE * out + lateral * across
    return Camera(
        f"camera{number}",
        np.array([*position, HEIGHT]),
        rotation_from_angles(angle + math.pi, 0.0, 0.0),
        np.array([500.0, 500.0]),
        np.array([319.5, 239.5]),
    )


def seen_motion(camera: Camera, start: Floats, direction: float) -> tuple[Floats, Floats]:
    """Movement to the right and growth of people's boxes (n,), as shares of box width and height.

    Args:
        camera: camera that sees them.
        start: (n, 2) positions before.
        direction: direction in which they walk `STEP` [rad from east].
    """
    after = start + STEP * np.array([math.cos(direction), math.sin(direction)])
    a, b = (expected_boxes(camera, xy, PERSON) for xy in (start, after))
    across = (b[:, 0] + b[:, 2] - a[:, 0] - a[:, 2]) / (2.0 * (a[:, 2] - a[:, 0]))
    return across, (b[:, 3] - b[:, 1]) / (a[:, 3] - a[:, 1]) - 1.0


def motion_trial(spec: Spec) -> dict[str, float]:
    """Shares of people near the middle for whom each printed statement holds.

    Args:
        spec: `people`, `seed` and `run`.

    Returns:
        `DIRECTION-CAMERA` for the printed statements; `alike`: share of cases in which two people who walk the same
        diagonal direction have the same signs of movement and growth in a camera; `apart`: for opposite directions.
    """
    rng = np.random.default_rng(np.random.SeedSequence(int(spec["seed"]), spawn_key=(int(spec["run"]),)))
    start = rng.uniform(-AROUND, AROUND, (2 * int(spec["people"]), 2))
    out: dict[str, float] = {}
    signs: dict[tuple[str, int], Floats] = {}
    for number in PLACES:
        camera = camera_of(number)
        for name, angle in DIRECTIONS.items():
            across, growth = seen_motion(camera, start, math.radians(angle))
            signs[name, number] = np.stack([np.sign(across), np.sign(growth)])
            if name in PRINTED:
                side, change = PRINTED[name][number]
                holds = _holds(across, SIDEWAYS[side], STEP / (0.3 * PERSON)) & _holds(
                    growth, GROWTH[change], STEP / DISTANCE
                )
                out[f"{name}-{number}"] = float(holds.mean())
    n = int(spec["people"])
    diagonal = ("NE", "SE", "NW", "SW")
    opposite = dict(zip(diagonal, ("SW", "NW", "SE", "NE"), strict=True))
    similar = [(signs[d, c][:, :n] == signs[d, c][:, n:]).all(axis=0) for d in diagonal for c in PLACES]
    opposite_signs = [
        (signs[d, c][:, :n] == signs[opposite[d], c][:, n:]).all(axis=0) for d in diagonal for c in PLACES
    ]
    return out | {"alike": float(np.mean(similar)), "apart": float(np.mean(opposite_signs))}


def _holds(change: Floats, sign: int, full: float) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """(n,) mask of changes that have a sign and are large enough to be seen; for sign 0, of small ones.

    `full` is the largest change that a camera sees.
    """
    seen = np.abs(change) > STILL * full
    return np.asarray((np.sign(change) == sign) & seen if sign else np.abs(change) < 0.5 * full)


def motions(size: Size, execute: Execute) -> Table:
    """Table of the share of people for whom each printed statement on apparent motion holds, by camera.

    `size.steps` is the number of people.
    """
    found = execute(
        [{"kind": "lee-motion", "people": size.steps, "seed": size.seed, "run": r} for r in range(size.runs)]
    )
    rows = [
        PaperRow(f"moves {name}", number, tuple(f[f"{name}-{number}"] for f in found))
        for name in PRINTED
        for number in PLACES
    ]
    for name, series in (("alike", "two who move alike"), ("apart", "two who move oppositely")):
        rows.append(PaperRow(series, math.nan, tuple(f[name] for f in found), plotted=False))
    return rows


def judge_motions(table: Table) -> list[StatementVerdict]:
    """Verdicts on how people who move north and north-east appear to move, and whether motion distinguishes people."""
    out = []
    for name, figure in (("N", "5-8"), ("NE", "5-9")):
        for number in PLACES:
            side, change = PRINTED[name][number]
            words = " and ".join([*([f"move {side}"] if side else []), *([f"get {change}"] if change else [])])
            row = v.find(table, f"moves {name}", float(number))
            statement = (
                f"Fig. {figure}: who moves {name} is seen to {words} by camera {number}; share of the positions."
            )
            out.append(_share(f"motion-{name}-{number}", statement, row))
    row = v.find(table, "two who move alike")
    statement = (
        "Two people who move in the same direction cannot be distinguished by that; share of cameras with equal signs."
    )
    out.append(_share("motion-alike", statement, row))
    pairs = [(low, high) for low, high in [(v.find(table, "two who move oppositely"), row)] if low and high]
    statement = "People are distinguished by different movements (equal signs are rarer, by this)."
    return [*out, v.pairs("motion-apart", statement, pairs)]


def _share(key: str, statement: str, row: PaperRow | None) -> StatementVerdict:
    """Verdict on whether a share is 1: at least .99 is reproduced, at least .5 in part.

    Args:
        key: id of the verdict.
        statement: text of the statement.
        row: row with the shares; None: missing.
    """
    measured = sample(() if row is None else row.values)
    rule = "a share of at least .99; in part from .5 on"
    return v.judge(key, statement, measured, v.at_least(0.99), v.at_least(0.5), rule=rule, paper=1.0)


MOTION = Experiment(
    item="motion",
    title="Figs. 5-8 and 5-9: movement in the images",
    x_label="camera",
    y_label="share of the positions",
    runs=20,
    steps=100,
    quick=(5, 20),
    compute=motions,
    judge=judge_motions,
    trial=motion_trial,
    note="Steps are people who start near the middle; cameras are 8 m from it, as the statements require.",
)
"""Signs of projected motion."""
