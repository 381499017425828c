"""Simulated crowds: people who walk about in a room, and the boxes that detectors of its cameras make of them.

Independent of the filter's model: bodies are stacks of rings (legs, trunk, head) whose points are projected one by
one, and a body is hidden where the points of nearer bodies' outlines are before it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Floats
from occlog.records.scene import Camera, Scene, camera_fov, camera_rotation
from occlog.track.methods.jipda.interface import NO_ID, FrameDetections

RINGS = ((0.0, 0.6), (0.08, 0.7), (0.3, 0.75), (0.5, 0.9), (0.65, 1.0), (0.8, 1.0), (0.86, 0.5), (1.0, 0.2))
"""Height and radius of the rings of a body, as shares of its height and of half its width."""
AROUND = 12
APART = 0.55
"""Distance [m] that people keep."""


class Crowd(NamedTuple):
    """A simulated crowd."""

    scene: Scene
    moments: list[list[FrameDetections]]
    truth: Floats  # (T, n, 2) places; NaN: not in the room


def cameras_around(count: int, width: float, depth: float, metre: float = 1.0, seed: int = 0) -> tuple[Camera, ...]:
    """Cameras near the walls of a room, 2.6 to 3.4 m high, directed at places around its middle."""
    rng = np.random.default_rng(seed)
    out = []
    for k in range(count):
        angle = 2.0 * np.pi * (k + 0.5) / count
        edge = min(0.5 * width / max(abs(np.cos(angle)), 1e-9), 0.5 * depth / max(abs(np.sin(angle)), 1e-9))
        place = np.array([0.5 * width + (edge + 1.0) * np.cos(angle), 0.5 * depth + (edge + 1.0) * np.sin(angle)])
        aim = np.array([width, depth]) * rng.uniform(0.4, 0.6, 2)
        height = rng.uniform(2.6, 3.4)
        yaw = np.arctan2(aim[1] - place[1], aim[0] - place[0])
        pitch = -np.arctan2(height - 1.0, np.hypot(*(aim - place)))
        focal, principal = np.array([1000.0, 1000.0]), np.array([639.5, 359.5])
        rotation = camera_rotation(float(yaw), float(pitch), 0.0)
        fov = camera_fov((1280, 720), focal, principal, np.zeros(5), "brown", rotation)
        out.append(
            Camera(f"cam{k + 1}", np.array([*place, height]) * metre, rotation, focal, principal, (1280, 720), fov=fov)
        )
    return tuple(out)


def walk(people: int, frames: int, hz: float, width: float, depth: float, rng: np.random.Generator) -> Floats:
    """(T, n, 2) places [m] of people who walk with a speed and a heading that drift, and turn back at the walls."""
    dt = 1.0 / hz
    place = rng.uniform([0.5, 0.5], [width - 0.5, depth - 0.5], (people, 2))
    speed, heading = rng.uniform(0.3, 1.4, people), rng.uniform(-np.pi, np.pi, people)
    out = np.empty((frames, people, 2))
    for t in range(frames):
        out[t] = place
        heading = heading + rng.normal(0.0, 0.25 * np.sqrt(dt), people)
        speed = np.clip(speed + rng.normal(0.0, 0.12 * np.sqrt(dt), people), 0.1, 1.6)
        # Walls: turn smoothly towards the middle when close
        inward = np.arctan2(0.5 * depth - place[:, 1], 0.5 * width - place[:, 0])
        close = np.minimum(np.minimum(place[:, 0], width - place[:, 0]), np.minimum(place[:, 1], depth - place[:, 1]))
        turn = (inward - heading + np.pi) % (2.0 * np.pi) - np.pi
        heading = heading + np.where(close < 1.0, np.clip(turn, -1.2 * dt, 1.2 * dt), 0.0)
        step = speed[:, None] * np.column_stack([np.cos(heading), np.sin(heading)]) * dt
        place = place + step
        # Bodies do not pass through each other: those closer than `APART` step aside
        apart = place[:, None] - place[None]
        gap = np.hypot(apart[..., 0], apart[..., 1]) + np.eye(people)
        push = np.clip(APART - gap, 0.0, None) * (1.0 - np.eye(people))
        place = place + 0.5 * np.sum(apart / gap[..., None] * push[..., None], axis=1)
        place = np.clip(place, 0.1, [width - 0.1, depth - 0.1])
    return out


def crowd(
    people: int,
    cameras: int = 4,
    frames: int = 100,
    hz: float = 10.0,
    size: tuple[float, float] = (10.0, 8.0),
    miss: float = 0.1,
    false: float = 0.5,
    px: float = 3.0,
    hidden: float = 0.6,
    metre: float = 1.0,
    seed: int = 0,
    colours: int = 0,
    similar: float = 20.0,
    lean: Floats | None = None,
) -> Crowd:
    """A crowd and its boxes.

    Args:
        people: how many, all the time.
        cameras: around the room.
        frames: of each camera, all at the same times.
        hz: of the cameras.
        size: of the room [m].
        miss: probability that a person in view is not detected.
        false: expected boxes of no one a camera and frame.
        px: standard deviation of an edge [px].
        hidden: people of whom nearer ones cover more than this share are not detected.
        metre: in the scene's unit.
        seed: of everything.
        colours: of a histogram of each box, Dirichlet about that of the person; 0: boxes have none.
        similar: concentration of boxes' histograms about the person's; that of persons, and of no one's boxes, is 1.
        lean: (frames, people) angle [rad] by which a body has fallen over along x, about its feet; None: all stand.
    """
    rng = np.random.default_rng(seed)
    # Colours have draws of their own, so that boxes are the same with and without
    paint = np.random.default_rng((seed, 1))
    clothes = paint.dirichlet(np.ones(colours), people) if colours else np.zeros((people, 0))
    views = cameras_around(cameras, *size, metre=metre, seed=seed)
    truth = walk(people, frames, hz, *size, rng)
    height, girth = rng.normal(1.7, 0.09, people), rng.normal(0.52, 0.05, people)
    angle = 2.0 * np.pi * np.arange(AROUND) / AROUND
    ring = np.array([[0.5 * r * np.cos(a), 0.5 * r * np.sin(a), z] for z, r in RINGS for a in angle])
    moments = []
    for t in range(frames):
        observations = []
        for c, view in enumerate(views):
            boxes, far = _bodies(
                view, truth[t], height, girth, ring, metre, np.zeros(people) if lean is None else lean[t]
            )
            own = [i for i in range(people) if _seen(i, boxes, far, hidden, rng) and rng.random() > miss]
            found = boxes[own].reshape(-1, 4)
            found = found + rng.normal(0.0, px, found.shape)
            empty = []
            for _ in range(rng.poisson(false)):
                w, u, v = rng.uniform(30.0, 120.0), rng.uniform(0.0, 1280.0), rng.uniform(50.0, 720.0)
                empty.append([u - 0.5 * w, v - 2.9 * w, u + 0.5 * w, v])
            found = np.concatenate([found, np.array(empty).reshape(-1, 4)])
            observation = _histograms(clothes[own], len(empty), similar, paint)
            # A detector's boxes end at the border of the image
            found = np.clip(found, 0.0, [1279.0, 719.0, 1279.0, 719.0])
            large = (found[:, 2] - found[:, 0] > 4.0) & (found[:, 3] - found[:, 1] > 8.0)
            found, observation = found[large], observation[large]
            order = rng.permutation(len(found))
            found, observation = found[order], observation[order]
            n = len(found)
            observations.append(
                FrameDetections(
                    t_ns=round(t * NS / hz),
                    camera=c,
                    boxes=found,
                    score=np.full(n, np.nan),
                    tracklet_id=np.full(n, NO_ID),
                    appearance=observation,
                    row=np.arange(n),
                )
            )
        moments.append(observations)
    return Crowd(Scene(cameras=views, length_unit="m" if metre == 1.0 else "cm"), moments, truth * metre)


def _histograms(clothes: Floats, absent: int, similar: float, rng: np.random.Generator) -> Floats:
    """Histograms of the boxes of people in these clothes (n, K), and of so many boxes of no one."""
    K = clothes.shape[1]
    if not K:
        return np.zeros((len(clothes) + absent, 0))
    own = [rng.dirichlet(similar * c + 0.05) for c in clothes]
    return np.array([*own, *rng.dirichlet(np.ones(K), absent)]).reshape(-1, K)


def _bodies(
    view: Camera, positions: Floats, height: Floats, girth: Floats, ring: Floats, metre: float, lean: Floats
) -> tuple[Floats, Floats]:
    """Boxes (n, 4) of all points of n bodies, NaN of those that are not in the image, and their distances (n,)."""
    points = np.empty((len(positions), len(ring), 3))
    across, up = girth[:, None, None] * ring[:, :2], height[:, None] * ring[:, 2]
    cos, sin = np.cos(lean)[:, None], np.sin(lean)[:, None]
    points[..., :2] = positions[:, None] + across
    points[..., 0] += (cos - 1.0) * across[..., 0] + sin * up
    points[..., 2] = np.maximum(cos * up - sin * across[..., 0], 0.0)
    pixels = view.project(points.reshape(-1, 3) * metre).reshape(len(positions), len(ring), 2)
    boxes = np.concatenate([pixels.min(axis=1), pixels.max(axis=1)], axis=1)
    u, v = 0.5 * (boxes[:, 0] + boxes[:, 2]), 0.5 * (boxes[:, 1] + boxes[:, 3])
    shown = np.isfinite(boxes).all(axis=1) & (u > 0.0) & (u < 1279.0) & (v > 0.0) & (v < 719.0)
    boxes[~shown] = np.nan
    return boxes, np.hypot(*(positions * metre - view.position[:2]).T)


def _seen(i: int, boxes: Floats, far: Floats, hidden: float, rng: np.random.Generator) -> bool:
    """Whether nearer bodies leave enough of body i, by random places in its box."""
    box = boxes[i]
    if not np.isfinite(box).all():
        return False
    u, v = rng.uniform(box[0], box[2], 60), rng.uniform(box[1], box[3], 60)
    # A body that is not in the image covers nothing: NaN is neither above nor below
    left, top, right, bottom = boxes[far < far[i], :, None].transpose(1, 0, 2)
    covered = ((u > left) & (u < right) & (v > top) & (v < bottom)).any(axis=0)
    return float(covered.mean()) <= hidden
