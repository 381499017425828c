"""Synthetic video of [Qu] Sec. 4.1: identical balls with mutual occlusion, seen by several cameras.

Positions of the balls are in `motion`; here are the images, the scene, and the ground truth of each frame.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import permutations, product
from queue import SimpleQueue
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from occlog.array_types import Bytes, Floats, Floats32
from occlog.core.image import support_radius
from occlog.core.numerics.seeds import RandomStream, generator
from occlog.records.scene import Camera, Scene
from occlog.records.tables import Truth, TruthBoxes
from occlog.simulate.render.surfaces import smooth_noise

from .config import BallsConfig
from .kernel import RenderView, Skin, clear_balls, deliver_into, paint_balls_into, trace_balls_into
from .motion import BallPaths, ball_box, ball_cameras, ball_ellipses, ball_paths

PENTAGON = np.array([120.0, 60.0, 34.0])
HEXAGON = np.array([176.0, 214.0, 242.0])
SEAM = np.array([70.0, 84.0, 96.0])
WALL = np.array([104.0, 136.0, 122.0])
LAMP = np.array([-0.35, 0.25, 0.9])
CIRCUMSCRIBED = 2.47802
"""Radius about a truncated icosahedron of edge 1."""
NOISE = 1 << 18
"""Pixels for which sensor noise is drawn once; every row of every frame takes a section at random."""


class BallsFrame(NamedTuple):
    """Images of V views at one time, with the truth about n balls.

    Attributes:
        frame: number of the frame.
        images: V images (H, W, 3) BGR.
        ellipses: (V, n, 5) true outlines of the whole balls: centre x, y [px], half axes [px], angle of the first
            [rad].
        share: (V, n) visible share of the part of each ball that is in the image; 0: hidden or outside.
    """

    frame: int
    images: tuple[Bytes, ...]
    ellipses: Floats
    share: Floats


class ViewCanvas(NamedTuple):
    """Constant data for rendering one view of the balls: its number, camera, and background (H, W, 3) BGR.

    `view` has the camera's focal length and centre [px], and the direction of the lamp in its frame.
    """

    number: int  # of the view
    camera: Camera
    view: RenderView  # its numbers, for the kernels
    background: Floats32  # (H, W, 3)


def render_balls(
    config: BallsConfig, seed: int, workers: int = 1, paths: BallPaths | None = None
) -> Iterator[BallsFrame]:
    """Render the synthetic video of [Qu] Sec. 4.1, frame by frame.

    Args:
        config: settings of balls, motion and views.
        seed: seed of all random numbers; a frame's noise depends on seed, view and frame number only.
        workers: number of frames rendered at the same time; the result does not depend on it.
        paths: paths of the balls; None: those of `ball_paths`.

    Returns:
        Generator of as many frames as the paths have; InputError if the balls have no room.
    """
    paths = ball_paths(config, seed) if paths is None else paths
    canvases = [_view_canvas(config, seed, k, camera) for k, camera in enumerate(ball_cameras(config))]
    noise = _noise(config, generator(seed, RandomStream.RENDER_SENSOR))
    buffers: SimpleQueue[tuple[Floats, NDArray[np.int32]]] = SimpleQueue()
    for _ in range(workers):
        shape = (config.height, config.width, 4)
        buffers.put((np.full(shape, np.inf), np.zeros(shape, dtype=np.int32)))

    def drawn_at(t: int) -> BallsFrame:
        depth, label = buffers.get()
        drawn = [
            _draw(config, seed, canvas, t, paths=paths, noise=noise, depth=depth, label=label) for canvas in canvases
        ]
        buffers.put((depth, label))
        outlines = np.stack([ball_ellipses(c.camera, paths.centres[t], config.radius) for c in canvases])
        return BallsFrame(t, tuple(image for image, _ in drawn), outlines, np.stack([share for _, share in drawn]))

    numbers = range(len(paths.centres))
    if workers == 1:
        yield from map(drawn_at, numbers)
        return
    with ThreadPoolExecutor(workers) as pool:
        for first in range(0, len(numbers), 8 * workers):
            yield from pool.map(drawn_at, numbers[first : first + 8 * workers])


def _draw(
    config: BallsConfig,
    seed: int,
    canvas: ViewCanvas,
    t: int,
    paths: BallPaths,
    noise: Floats32,
    depth: Floats,
    label: NDArray[np.int32],
) -> tuple[Bytes, Floats]:
    """Render one image (H, W, 3) BGR, and return it with the visible shares (n,) of the balls, 0 to 1.

    Args:
        config: settings of the balls.
        seed: seed of the sensor noise.
        canvas: camera and background of the view.
        t: number of the frame.
        paths: paths of the balls.
        noise: sensor noise of a long row of pixels; each row of the image takes a random section.
        depth: (H, W, 4) buffer of inf; restored at the end.
        label: (H, W, 4) buffer; its contents are overwritten.
    """
    centres = np.ascontiguousarray((paths.centres[t] - canvas.camera.position) @ canvas.camera.rotation)
    turns = np.ascontiguousarray(canvas.camera.rotation.T @ paths.turns[t])
    covered, visible = np.zeros((len(centres), 5), dtype=np.int64), np.zeros(len(centres), dtype=np.int64)
    light = canvas.background.copy()
    # Cast: which ball each line of sight meets first
    trace_balls_into(depth=depth, label=label, covered=covered, centres=centres, radius=config.radius, view=canvas.view)
    # Shade the balls, and count the pixels in which each can be seen
    paint_balls_into(
        light,
        depth,
        label,
        visible,
        covered,
        background=canvas.background,
        centres=centres,
        turns=turns,
        radius=config.radius,
        view=canvas.view,
        skin=FOOTBALL,
    )
    clear_balls(depth, covered)
    # Sensor: noise, then whole grey levels
    rng = generator(seed, RandomStream.RENDER_SENSOR, canvas.number, t)
    image, flat = np.empty(light.shape, dtype=np.uint8), (config.height, 3 * config.width)
    starts = 3 * rng.integers(0, NOISE, config.height)
    deliver_into(image.reshape(flat), light.reshape(flat), noise, starts)
    return image, visible / np.maximum(covered[:, 4], 1)


def _noise(config: BallsConfig, rng: np.random.Generator) -> Floats32:
    """(3 (NOISE + width),) sensor noise of the three colours of pixels in a row [grey levels], plus 0.5 for rounding.

    Each row of an image takes a random section of it.
    """
    n = NOISE + config.width
    common, single = rng.standard_normal((n, 1), dtype=np.float32), rng.standard_normal((n, 3), dtype=np.float32)
    return np.asarray(0.5 + config.noise * common + config.colour_noise * single, dtype=np.float32).ravel()


def football_faces() -> Floats:
    """(32, 3) unit normals of a truncated icosahedron's faces, each divided by the face's distance from the centre.

    Edges have the length 1. First the 12 pentagons, then the 20 hexagons.
    """
    golden = 0.5 * (1.0 + 5.0**0.5)
    corners = np.array([[0.0, a, b * golden] for a, b in product((-1.0, 1.0), repeat=2)])
    corners = np.vstack([np.roll(corners, k, axis=1) for k in range(3)]) / np.hypot(1.0, golden)
    # Faces of an icosahedron are the triples of corners that are neighbours.
    near = corners @ corners.T > 0.4
    triples = [t for t in permutations(range(12), 3) if t[0] < t[1] < t[2] and near[np.ix_(t, t)].all()]
    middles = np.array([corners[list(t)].sum(axis=0) for t in triples])
    middles /= np.linalg.norm(middles, axis=1, keepdims=True)
    # Distances of the two kinds of faces from the centre, for edges of length 1
    return np.vstack([corners / 2.32744, middles / 2.26728])


def football() -> Skin:
    """Faces of a football and their colours: dark pentagons, light hexagons, seams; only faces that shading uses."""
    faces = football_faces() * CIRCUMSCRIBED
    used = _first_or_second(faces)
    return Skin(np.ascontiguousarray(faces[used]), int(used[:12].sum()), 0.035, np.vstack([PENTAGON, HEXAGON, SEAM]))


def _first_or_second(faces: Floats) -> NDArray[np.bool_]:
    """(F,) mask of faces that are nearest or second nearest to some direction with x, y, z >= 0.

    `faces` (F, 3) are their normals over their distances from the centre; the nearest one has the largest scalar
    product with the direction. By symmetry these faces are sufficient for shading.
    """
    x, y, z = np.meshgrid(*3 * [np.linspace(0.0, 1.0, 25)])
    points = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    points = points[np.linalg.norm(points, axis=1) > 0.5]
    used = np.zeros(len(faces), dtype=np.bool_)
    used[np.argsort(points @ faces.T, axis=1)[:, -2:].ravel()] = True
    return used


def _view_canvas(config: BallsConfig, seed: int, number: int, camera: Camera) -> ViewCanvas:
    lamp = LAMP / np.linalg.norm(LAMP)
    cx, cy = camera.principal_px.tolist()
    view = RenderView(float(camera.focal_px[0]), cx, cy, np.ascontiguousarray(camera.rotation.T @ lamp))
    return ViewCanvas(number, camera, view, _background(config, generator(seed, RandomStream.RENDER_CLOTHES, number)))


def _background(config: BallsConfig, rng: np.random.Generator) -> Floats32:
    """(height, width, 3) mottled background, levels 0 to 255, with rectangular patches in the colours of the balls."""
    height, width = config.height, config.width
    x, y = (a.ravel().astype(np.float64) for a in np.meshgrid(np.arange(width), np.arange(height)))
    grain_seed = int(rng.integers(1 << 20))
    mottle = 0.16 * smooth_noise(x, y, 61.0, grain_seed) + 0.10 * smooth_noise(x, y, 9.0, grain_seed + 1)
    wall = (WALL * (1.0 + mottle[:, None])).reshape(height, width, 3)
    for _ in range(config.background_clutter):
        w, h = (max(1, round(config.radius * rng.uniform(0.4, 1.4))) for _ in range(2))
        left, top = int(rng.integers(max(1, width - w))), int(rng.integers(max(1, height - h)))
        mix = rng.uniform(0.25, 0.9)
        paint = mix * (HEXAGON if rng.random() < 0.6 else PENTAGON) + (1.0 - mix) * WALL
        patch = wall[top : top + h, left : left + w]
        patch *= paint / WALL
    return np.clip(wall, 0.0, 255.0).astype(np.float32)


FOOTBALL = football()


def balls_scene(config: BallsConfig, rate_hz: float) -> Scene:
    """Scene with cameras `view1`, `view2`, ... around the box of the balls; lengths are pixels.

    Args:
        config: settings of balls and views.
        rate_hz: frame rate of the cameras.
    """
    x, y, z = ball_box(config).tolist()
    return Scene(
        cameras=tuple(replace(camera, rate_hz=rate_hz) for camera in ball_cameras(config)),
        room=np.array([[-x, -y], [x, -y], [x, y], [-x, y]]),
        room_height=0.5 * config.height + z,
        length_unit="px",
    )


def balls_truth(centres: Floats, t_ns: int) -> Truth:
    """Table of the true positions `centres` (n, 3) of all balls at `t_ns` [ns]; each is a target."""
    n = len(centres)
    return Truth.of(
        t_ns=np.full(n, t_ns),
        target_id=np.arange(n, dtype=np.int32),
        role=np.full(n, "target"),
        x=centres[:, 0],
        y=centres[:, 1],
        z=centres[:, 2],
    )


def balls_boxes(frame: BallsFrame, cameras: tuple[Camera, ...], t_ns: int) -> list[TruthBoxes]:
    """Tables of true boxes, one per view, of all balls of a frame that reach into the image, at `t_ns` [ns].

    Occluded balls are included, with their visible share.
    """
    return [_boxes(frame.ellipses[k], frame.share[k], camera, frame.frame, t_ns) for k, camera in enumerate(cameras)]


def _boxes(ellipses: Floats, share: Floats, camera: Camera, frame: int, t_ns: int) -> TruthBoxes:
    width, height = camera.image_size or (0, 0)
    across, down = support_radius(ellipses, 0.0), support_radius(ellipses, 0.5 * np.pi)
    x, y = ellipses[:, 0], ellipses[:, 1]
    inside = (x + across > -0.5) & (x - across < width - 0.5) & (y + down > -0.5) & (y - down < height - 0.5)
    ids = np.flatnonzero(inside) if inside.any() else np.array([-1])
    n, nan = len(ids), np.full(len(ids), np.nan)
    some = ids[0] >= 0
    return TruthBoxes.of(
        t_ns=np.full(n, t_ns),
        sensor=np.full(n, camera.name),
        frame=np.full(n, frame),
        box=(np.arange(n) if some else ids).astype(np.int32),
        target_id=ids.astype(np.int32),
        left_px=(x - across)[ids] if some else nan,
        top_px=(y - down)[ids] if some else nan,
        width_px=2 * across[ids] if some else nan,
        height_px=2 * down[ids] if some else nan,
        confidence=nan,
        visible=share[ids] if some else nan,
    )
