"""Staged videos: balls on paths that produce one situation described in [Qu], and balls that a view does not see.

Camera 1 sees -y and z of a ball, camera 2 sees x and z, and the epipolar lines are the rows.  A scene draws what
the statement leaves open from its seed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import Floats
from occlog.core.numerics.seeds import RandomStream, generator
from occlog.errors import InputError
from occlog.simulate.balls.config import BallsConfig
from occlog.simulate.balls.motion import BallPaths, ball_paths
from occlog.simulate.balls.video import BallsFrame, render_balls

APART = 2.4
"""Distance of separate balls [radii]."""
HIDING = 0.2
"""Distance of balls of which one hides the other [radii]."""
ASIDE = 60.0
"""Half the distance of two balls across the view in which they meet [px]."""
OUT = 10_000.0
"""Distance [px] at which a ball is outside the image."""


class Staging(NamedTuple):
    """Staged content of a video instead of freely moving balls.

    Attributes:
        scene: one of `SCENES`; empty: balls that move freely.
        unseen: numbers of balls that the first view does not see.
    """

    scene: str = ""
    unseen: tuple[int, ...] = ()


def staging_of(scene: str, unseen: tuple[int, ...]) -> Staging:
    """What a video shows: a `scene` of `SCENES`, or empty, and the balls that the first view does not see.

    Raises:
        InputError: the scene is unknown.
    """
    if scene and scene not in SCENES:
        raise InputError(f"trial: scene is {scene!r}, must be one of {', '.join(SCENES)}", id="unknown-name")
    return Staging(scene, unseen)


def video_of(config: BallsConfig, seed: int, staging: Staging) -> Iterator[BallsFrame]:
    """Generate the frames of a staged video; a ball that the first view does not see has NaN as its outline there.

    Its visible share in this view is 0.

    Args:
        config: settings of the video.
        seed: seed of paths and textures.
        staging: scene and unseen balls.
    """
    paths = ball_paths(config, seed) if not staging.scene else staged_paths(config, seed, staging.scene)
    if not staging.unseen:
        yield from render_balls(config, seed, paths=paths)
        return
    # The first view is drawn with the unseen balls far aside: behind nothing, and in front of nothing
    unseen = list(staging.unseen)
    aside = paths._replace(centres=paths.centres.copy())
    aside.centres[:, unseen, 1] = OUT
    for frame, first in zip(
        render_balls(config, seed, paths=paths), render_balls(config, seed, paths=aside), strict=True
    ):
        ellipses, share = frame.ellipses.copy(), frame.share.copy()
        ellipses[0, unseen], share[0] = np.nan, first.share[0]
        share[0, unseen] = 0.0
        yield BallsFrame(frame.frame, (first.images[0], *frame.images[1:]), ellipses, share)


def staged_paths(config: BallsConfig, seed: int, scene: str) -> BallPaths:
    """Paths of the balls of a staged scene [px]; their turns are those of the seed's own video.

    Raises:
        InputError: `config` has another number of balls than the scene.
    """
    rng = generator(seed, RandomStream.WORLD_MOTION, config.balls)
    positions = SCENES[scene](config, rng)
    if positions.shape[1] != config.balls:
        raise InputError(f"trial: scene {scene} has {positions.shape[1]} balls, not {config.balls}; give this number")
    middle = np.array([0.0, 0.0, 0.5 * config.height])
    return BallPaths(positions + middle, ball_paths(config, seed).turns)


def _together(config: BallsConfig, rng: Generator) -> Floats:
    """Centres (frames, 2, 3) [px] of two balls that move together in view 1, occluding each other ([Qu] Fig. 7b)."""
    t = np.linspace(0.0, 1.0, config.frames)
    first, last = (rng.uniform(0.0, 2.0 * math.pi) for _ in range(2))
    near = rng.uniform(0.0, 2.0 * math.pi)
    come, go = _smooth(t / 0.3), _smooth((t - 0.65) / 0.35)
    far, close = APART * config.radius, HIDING * config.radius
    gap = (
        far * np.outer(1.0 - come, _unit(first))
        + close * np.outer(come * (1.0 - go), _unit(near))
        + far * np.outer(go, _unit(last))
    )
    return _seen_in_first(np.outer(200.0 * (t - 0.5), [1.0, 0.0]), gap, rng)


def _together_in_second(config: BallsConfig, rng: Generator) -> Floats:
    """Centres (frames, 2, 3) [px] of two balls that move together in view 2, occluding each other there."""
    return _together(config, rng)[..., [1, 0, 2]]


def _opposite(config: BallsConfig, rng: Generator) -> Floats:
    """Centres (frames, 2, 3) [px] of two balls that pass one another in view 1, in opposite directions."""
    t = np.linspace(0.0, 1.0, config.frames)
    close = HIDING * config.radius * rng.choice([-1.0, 1.0])
    gap = np.column_stack([400.0 * (t - 0.5), np.full(len(t), close)])
    return _seen_in_first(np.zeros((len(t), 2)), gap, rng)


def _seen_in_first(middle: Floats, gap: Floats, rng: Generator) -> Floats:
    """Centres (T, 2, 3) [px] of two balls with given middle and gap in view 1; separate in view 2.

    Args:
        middle: (T, 2) middle of the two along y and z [px].
        gap: (T, 2) second ball less first along y and z [px].
        rng: draws which of the two is on which side in view 2.
    """
    side = rng.choice([-1.0, 1.0])
    x = np.broadcast_to([side * ASIDE, -side * ASIDE], (len(gap), 2))
    positions = np.stack([middle - 0.5 * gap, middle + 0.5 * gap], axis=1)
    return np.concatenate([x[..., None], positions], axis=2)


def _following(angle: float, *, across: bool = False, back: bool = False) -> Callable[[BallsConfig, Generator], Floats]:
    """Function that draws paths of a ball that approaches another from behind in view 2, on one line ([Qu] Fig. 7b).

    Args:
        angle: angle of the line with the rows, which are the epipolar lines [deg].
        across: whether the other ball moves at a right angle to the line instead.
        back: whether the ball falls back, when it hides the other, instead of overtaking it.
    """

    def positions(config: BallsConfig, rng: Generator) -> Floats:
        t = np.linspace(-0.5, 0.5, config.frames)
        turn = math.radians(angle + rng.uniform(-10.0, 10.0) * (angle > 0.0))
        along, normal = _unit(turn), _unit(turn + 0.5 * math.pi)
        slip = rng.uniform(-1.0, 1.0) * HIDING * config.radius
        # Along the line both go the same way; the one behind gains on the other
        gap = 1.2 * APART * config.radius * (-np.sqrt(t * t + 0.0025) if back else t) * 2.0
        second = np.outer(120.0 * t - 0.5 * gap, along)
        first = np.outer(120.0 * t + 0.5 * gap, along) + slip * normal
        if across:
            second = np.outer(120.0 * t, normal)
        side = rng.choice([-1.0, 1.0])
        y = np.broadcast_to([side * ASIDE, -side * ASIDE], (len(t), 2))
        seen = np.stack([first, second], axis=1)
        return np.stack([seen[..., 0], y, seen[..., 1]], axis=2)

    return positions


def _decoys(on_line: bool) -> Callable[[BallsConfig, Generator], Floats]:
    """Function that draws paths of four balls side by side that never touch.

    `on_line`: whether they are on one epipolar line; else they are in a column.
    """

    def positions(config: BallsConfig, rng: Generator) -> Floats:
        t = np.linspace(-0.5, 0.5, config.frames)
        order, other = rng.permutation(4) - 1.5, rng.permutation(4) - 1.5
        gap = APART * config.radius
        out = np.empty((len(t), 4, 3))
        drift = rng.uniform(-40.0, 40.0, 3) * [1.0, 1.0, 0.5]
        rest = rng.uniform(-30.0, 30.0)
        if on_line:
            out[:] = np.column_stack([gap * other, gap * order, np.full(4, rest)])
        else:
            gap = min(gap, (config.height - 2.0 * config.radius - 20.0) / 3.0)
            out[:] = np.column_stack([np.full(4, rest), np.full(4, rest), gap * order])
            drift[2] *= 0.5
        return out + t[:, None, None] * drift

    return positions


def _unit(angle: float) -> Floats:
    """Unit vector (2,) at an angle [rad] from the first axis."""
    return np.array([math.cos(angle), math.sin(angle)])


def _smooth(share: Floats) -> Floats:
    """Smooth step from 0 to 1 at the values `share`, which are cut to 0 to 1."""
    s = np.clip(share, 0.0, 1.0)
    return np.asarray(s * s * (3.0 - 2.0 * s))


SCENES: dict[str, Callable[[BallsConfig, Generator], Floats]] = {
    "together": _together,
    "together-in-second": _together_in_second,
    "opposite": _opposite,
    "overtaking": _following(60.0),
    "falling-back": _following(60.0, back=True),
    "right-angle": _following(60.0, across=True),
    "row-overtaking": _following(0.0),
    "row-falling-back": _following(0.0, back=True),
    "decoys-on-line": _decoys(on_line=True),
    "decoys-off-line": _decoys(on_line=False),
}
"""Scenes by name: settings and generator to positions (T, n, 3) about the centre of the box."""
