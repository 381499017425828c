"""People made of ellipsoids: where they face and are in their gait, where their parts are, what they wear.

Lengths of a body are metres for a person 1.75 m tall; `solids` scales and positions them.  A body
faces its heading; arms and legs swing with its phase, which grows by 2 pi with every two
steps.
"""

from __future__ import annotations

import colorsys
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.numerics.interpolate import TimeGrid

STATURE = 1.75
SKIN, HAIR, SHIRT, TROUSERS, SHOES = range(5)
PLAIN, HOOPS, STRIPES, CHECKS, SIDES = range(5)
THIGH, SHIN, UPPER_ARM, FOREARM = 0.44, 0.43, 0.28, 0.25
FULL_SWING = 0.5
"""Swing of a leg to either side at walking speed [rad]."""
WARM = (0.035, 0.93, 0.17, 0.29)
"""Hues of the targets' shirts, each in the middle of a bin of the appearance histogram."""


class Clothes(NamedTuple):
    """Clothes of n bodies; the five parts are skin, hair, shirt, trousers and shoes.

    Attributes:
        first, second: (n, 5, 3) BGR colours of the parts, 0 to 255; the second is that of patterned parts.
        pattern: (n, 5) number of the pattern of each part.
        stature: (n,) height over 1.75 m.
    """

    first: Floats
    second: Floats
    pattern: Ints
    stature: Floats


class Poses(NamedTuple):
    """Poses of n bodies: positions (n, 2) in scene units, headings (n, 2) as unit vectors, and gait.

    `phase` (n,) is that of the gait and `swing` (n,) that of the legs to either side [rad].
    """

    xy: Floats  # (n, 2) in scene units
    heading: Floats  # (n, 2) unit vectors
    phase: Floats  # (n,) of the gait [rad]
    swing: Floats  # (n,) of the legs to either side [rad]


class Solids(NamedTuple):
    """P ellipsoids in scene units, the parts of n bodies: the points p with |A (p - c)| = 1.

    Centres c (P, 3); matrices A (P, 3, 3) with the axes over their half lengths as rows; half lengths (P, 3);
    index of the body and kind of part (`SKIN` to `SHOES`) of each (P,).
    """

    centre: Floats  # (P, 3)
    axes: Floats  # (P, 3, 3) A: its rows are the axes over their half lengths
    half: Floats  # (P, 3) half lengths of the axes
    body: Ints  # (P,) which of the n bodies
    part: Ints  # (P,) SKIN to SHOES


def solids(poses: Poses, clothes: Clothes, metre: float) -> Solids:
    """Compute the ellipsoids of n bodies, those of one body in a row; the feet touch the floor.

    Args:
        poses: poses of the bodies.
        clothes: clothes of the bodies, with their statures over 1.75 m.
        metre: length of a metre in scene units.
    """
    build = _Builder(len(poses.xy))
    lowest = _legs(build, poses)
    _trunk(build)
    _arms(build, poses)
    n, k = len(poses.xy), len(build.part)
    scale = (clothes.stature * metre)[:, None, None]
    local = np.stack(build.centre, axis=1)
    local[..., 2] -= lowest[:, None]  # the standing leg carries the body
    frame = _frames(poses.heading)
    centre = scale * np.einsum("nkj,nij->nki", local, frame)
    centre[..., :2] += poses.xy[:, None]
    half = scale * np.stack(build.half, axis=1)
    turn = np.einsum("nij,nkjl->nkil", frame, np.stack(build.turn, axis=1))  # columns: axes in the world
    axes = np.swapaxes(turn, -1, -2) / half[..., None]
    body = np.repeat(np.arange(n), k)
    return Solids(
        centre.reshape(-1, 3), axes.reshape(-1, 3, 3), half.reshape(-1, 3), body, np.tile(np.array(build.part), n)
    )


class _Builder:
    """Collects the parts of n bodies as ellipsoids in the body's frame [m]: x forward, y left, z up.

    Each list has one entry per part: centres and half lengths (n, 3), rotations (n, 3, 3), and kind of part.
    """

    def __init__(self, n: int) -> None:
        self.n = n
        self.centre: list[Floats] = []
        self.half: list[Floats] = []
        self.turn: list[Floats] = []
        self.part: list[int] = []

    def ball(self, part: int, centre: Floats | tuple[float, ...], half: tuple[float, float, float]) -> None:
        self.centre.append(np.broadcast_to(np.asarray(centre, dtype=np.float64), (self.n, 3)))
        self.half.append(np.broadcast_to(np.array(half), (self.n, 3)))
        self.turn.append(np.broadcast_to(np.eye(3), (self.n, 3, 3)))
        self.part.append(part)

    def limb(self, part: int, start: Floats, angle: Floats, length: float, radius: float) -> Floats:
        """Add a limb hanging from `start`, swung forward by `angle`; return its other end (n, 3).

        Lengths are in metres, of bodies 1.75 m tall.

        Args:
            part: kind of part (`SKIN` to `SHOES`), which determines the clothes.
            start: (n, 3) upper end, in the body's frame.
            angle: (n,) angle from straight down [rad].
            length: length of the limb.
            radius: radius of the limb.
        """
        s, c, o = np.sin(angle), np.cos(angle), np.zeros(self.n)
        along = np.stack([s, o, -c], axis=-1)
        self.centre.append(start + 0.5 * length * along)
        self.half.append(np.broadcast_to(np.array([radius, radius, 0.5 * length + 0.7 * radius]), (self.n, 3)))
        columns = [np.stack([c, o, s], axis=-1), np.stack([o, o + 1, o], axis=-1), -along]
        self.turn.append(np.stack(columns, axis=-1))
        self.part.append(part)
        return np.asarray(start + length * along)


def _legs(build: _Builder, poses: Poses) -> Floats:
    """Add both legs of n bodies; return the height (n,) [m] of the lowest point of the shoes, above the floor or below.

    For bodies 1.75 m tall, with hips at standing height.
    """
    lowest = np.full(build.n, np.inf)
    for side in (1.0, -1.0):
        phase = poses.phase + (0.0 if side > 0 else np.pi)
        swing = poses.swing * np.sin(phase)
        bend = 1.3 * poses.swing * np.maximum(0.0, np.cos(phase))  # the knee bends while the leg swings forward
        hip = np.broadcast_to(np.array([0.0, 0.095 * side, 0.93]), (build.n, 3))
        knee = build.limb(TROUSERS, hip, swing, THIGH, 0.085)
        ankle = build.limb(TROUSERS, knee, swing - bend, SHIN, 0.06)
        build.ball(SHOES, ankle + np.array([0.06, 0.0, -0.015]), (0.13, 0.05, 0.045))
        lowest = np.minimum(lowest, ankle[:, 2] - 0.06)
    return lowest


def _trunk(build: _Builder) -> None:
    build.ball(TROUSERS, (0.0, 0.0, 0.95), (0.115, 0.165, 0.13))
    build.ball(SHIRT, (0.0, 0.0, 1.20), (0.12, 0.18, 0.29))
    build.ball(SHIRT, (-0.01, 0.0, 1.38), (0.105, 0.215, 0.11))
    build.ball(SKIN, (0.0, 0.0, 1.48), (0.055, 0.055, 0.09))
    build.ball(SKIN, (0.015, 0.0, 1.63), (0.095, 0.078, 0.12))
    build.ball(HAIR, (-0.015, 0.0, 1.66), (0.098, 0.085, 0.10))


def _arms(build: _Builder, poses: Poses) -> None:
    for side in (1.0, -1.0):
        phase = poses.phase + (np.pi if side > 0 else 0.0)  # against the leg of the same side
        swing = 0.8 * poses.swing * np.sin(phase)
        shoulder = np.broadcast_to(np.array([0.0, 0.225 * side, 1.40]), (build.n, 3))
        elbow = build.limb(SHIRT, shoulder, swing, UPPER_ARM, 0.052)
        wrist = build.limb(SHIRT, elbow, swing + 0.25, FOREARM, 0.042)
        build.ball(SKIN, wrist + np.array([0.01, 0.0, -0.05]), (0.045, 0.03, 0.07))


def _frames(heading: Floats) -> Floats:
    """Return (n, 3, 3) rotation matrices from body to world axes, from headings (n, 2) as unit vectors."""
    c, s, o = heading[:, 0], heading[:, 1], np.zeros(len(heading))
    columns = [np.stack([c, s, o], axis=-1), np.stack([-s, c, o], axis=-1), np.stack([o, o, o + 1], axis=-1)]
    return np.stack(columns, axis=-1)


class Outfit(NamedTuple):
    """Clothes of one body; the five parts are skin, hair, shirt, trousers and shoes.

    Attributes:
        first, second: (5, 3) BGR colours of the parts, 0 to 255; the second is that of patterned parts.
        pattern: (5,) number of the pattern of each part.
        stature: height over 1.75 m.
    """

    first: Floats
    second: Floats
    pattern: Ints
    stature: float


def dress(number: int, target: bool, rng: np.random.Generator, *, two_sided: bool = False) -> Outfit:
    """Draw clothes for one body: targets wear warm hooped shirts, each its own hue, others cool or grey ones.

    Args:
        number: number of the target among the targets, which determines the hue.
        target: whether the body is a target.
        rng: generator of all other choices.
        two_sided: the shirt is plain with another colour at the back: for a target that of the next one's front.
    """
    stature, tone, dark = rng.uniform(0.95, 1.05), rng.uniform(0.45, 1.0), rng.uniform(0.1, 0.45)
    hue, vivid, value = rng.uniform(0.4, 0.68), rng.choice([0.06, 0.5, 0.75]), rng.uniform(0.3, 0.75)
    trousers = _bgr(rng.uniform(0.5, 0.7), 0.25, rng.uniform(0.15, 0.5))
    pattern, other = int(rng.integers(PLAIN, CHECKS + 1)), 0.6 if rng.random() < 0.5 else 1.3
    if target:
        hue, vivid, value = WARM[number % len(WARM)] + 0.05 * (number // len(WARM)), 0.85, 0.8
        trousers, pattern, other = _bgr(0.6, 0.45, 0.5), HOOPS, 0.7
    behind = WARM[(number + 1) % len(WARM)] + 0.05 * (number // len(WARM))
    if two_sided and not target:
        behind = hue + rng.uniform(0.25, 0.75)
    skin = [tone * c for c in (150.0, 178.0, 224.0)]
    shoes = [38.0, 36.0, 34.0]
    first = np.array([skin, _bgr(0.07, 0.5, dark), _bgr(hue, vivid, value), trousers, shoes])
    patterns = np.zeros(5, dtype=np.int64)
    patterns[SHIRT] = pattern
    second = first * other
    if two_sided:
        patterns[SHIRT] = SIDES
        second[SHIRT] = _bgr(behind, vivid, value)
    return Outfit(first, second, patterns, stature)


def clothes_of(outfits: Sequence[Outfit]) -> Clothes:
    """The outfits of n bodies as arrays."""
    return Clothes(
        np.array([outfit.first for outfit in outfits]).reshape(-1, 5, 3),
        np.array([outfit.second for outfit in outfits]).reshape(-1, 5, 3),
        np.array([outfit.pattern for outfit in outfits], dtype=np.int64).reshape(-1, 5),
        np.array([outfit.stature for outfit in outfits], dtype=np.float64),
    )


def _bgr(hue: float, saturation: float, value: float) -> list[float]:
    return [255.0 * c for c in reversed(colorsys.hsv_to_rgb(hue % 1.0, saturation, value))]


STRIDE = 1.45
"""Way of two steps [m]."""
WALKING = 1.2
"""Speed at which the legs swing fully [m/s]."""
LAG_S = 0.35
"""Time constant with which a body turns and changes its gait."""


def walking(grids: Iterable[TimeGrid], metre: float) -> Iterator[TimeGrid]:
    """Add velocity and gait to chunks of positions: columns x, y, vx, vy [m/s], gait phase [rad], in place of x, y, z.

    The velocity is smoothed with a time constant of `LAG_S`, so that the noise of a path does not make its body
    shake; it starts in the direction of the first step. `metre` is the length of a metre in scene units.
    """
    last: TimeGrid | None = None
    for grid in grids:
        out = np.concatenate([grid.xyz[..., :2], np.zeros((*grid.xyz.shape[:2], 3))], axis=-1)
        position, velocity, phase = _start(last, grid, metre)
        before = int(grid.t_ns[0]) if last is None else int(last.t_ns[-1])
        for k, t in enumerate(grid.t_ns.tolist()):
            dt = (t - before) * 1e-9
            if dt > 0:
                seen = (out[k, :, :2] - position) / (metre * dt)
                velocity = velocity - np.expm1(-dt / LAG_S) * np.nan_to_num(seen - velocity)
                phase = phase + 2 * np.pi * dt * np.hypot(*velocity.T) / STRIDE
            position, before = out[k, :, :2], t
            out[k, :, 2:4], out[k, :, 4] = velocity, phase
        last = grid._replace(xyz=out)
        yield last


def _start(last: TimeGrid | None, grid: TimeGrid, metre: float) -> tuple[Floats, Floats, Floats]:
    """Position (n, 2), velocity (n, 2) [m/s] and gait phase (n,) [rad] of n objects before a chunk.

    They are those at the last time of the previous chunk, or, for a new object, at the first time of this one.

    Args:
        last: previous chunk, with velocity and phase in columns 2 to 4; None: there was none.
        grid: this chunk, with n objects.
        metre: length of a metre in scene units.
    """
    position = grid.xyz[0, :, :2].copy()
    velocity = np.zeros_like(position)
    velocity[:, 0] = 1e-6
    if len(grid.t_ns) > 1:
        dt = (int(grid.t_ns[1]) - int(grid.t_ns[0])) * 1e-9
        velocity += np.nan_to_num(grid.xyz[1, :, :2] - position) / (metre * dt)
    phase: Floats = 2.4 * np.arange(len(grid.ids), dtype=np.float64)  # not in step
    if last is not None:
        _, old, new = np.intersect1d(last.ids, grid.ids, return_indices=True)
        position[new], velocity[new], phase[new] = last.xyz[-1, old, :2], last.xyz[-1, old, 2:4], last.xyz[-1, old, 4]
    return position, velocity, phase


def poses(rows: Floats) -> Poses:
    """Convert (n, 5) rows of x, y, vx, vy, gait phase to the poses of n bodies."""
    speed = np.hypot(rows[:, 2], rows[:, 3])
    heading = rows[:, 2:4] / np.maximum(speed, 1e-12)[:, None]
    heading[speed < 1e-9] = (1.0, 0.0)
    swing = FULL_SWING * np.minimum(1.0, speed / WALKING)
    return Poses(rows[:, :2], heading, rows[:, 4], swing)
