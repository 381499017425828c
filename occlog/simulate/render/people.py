"""True paths to video: what cameras in a textured room see of the people who walk in it.

Bodies are ellipsoids drawn by casting lines of sight, so that any camera pose and lens
distortion, people in front of other people and behind walls and pillars come out right.

What the targets resemble: appearance histograms of their bodies rendered alone, for the detector.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import groupby
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from occlog.array_types import Bytes, Floats
from occlog.core.geometry.camera import rotation_from_angles
from occlog.core.image import N_BINS
from occlog.core.numerics.interpolate import SensorFrames, TimeGrid, frames_at
from occlog.core.numerics.seeds import RandomStream, generator
from occlog.errors import InputError
from occlog.measure.regions.regions import add_pixels_into, normalised
from occlog.records.scene import Camera, Scene
from occlog.records.tables import Truth, TruthBoxes
from occlog.settings import METRES
from occlog.simulate.config import RenderConfig
from occlog.simulate.world.scripted_paths import truth_grid

from .body import STATURE, WALKING, Clothes, clothes_of, dress, walking
from .frame import Canvas, RenderedFrame, bare_canvas, canvas, draw
from .surfaces import grey, lamps

NOISE = 1 << 22
"""Numbers drawn once for the sensor noise; every row of every frame takes a section at random."""
PERSON = 0.5
"""Width of a person [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Rendered:
    """One rendered frame of one camera, with its ground truth.

    Attributes:
        t_ns, sensor, index: time [ns], name of the camera, and number of the frame.
        image: (H, W, 3) BGR.
        boxes: boxes of the whole bodies, hidden parts included, clipped to the image.
        visible: boxes of the visible parts, without wholly hidden bodies.
        share: visible share of each body with a box, 0 to 1.
    """

    t_ns: int
    sensor: str
    index: int
    image: Bytes
    boxes: TruthBoxes
    visible: TruthBoxes
    share: Floats


class RenderJob(NamedTuple):
    """A frame of one camera that is to be rendered, with n bodies.

    Attributes:
        t_ns: time [ns].
        number: index of the camera among those drawn.
        frame: number of the frame.
        rows: (n, 5) x, y (scene units), vx, vy [m/s] and gait phase [rad] of the bodies.
        ids: (n,) numbers of the objects.
        clothes: their clothes.
    """

    t_ns: int
    number: int
    frame: int
    rows: Floats
    ids: NDArray[np.int64]
    clothes: Clothes


def scene_metre(scene: Scene, diameter: float) -> float:
    """Length of a metre in scene units; without a known length unit a person of `diameter` is taken as 0.5 m wide."""
    return 1.0 / METRES[scene.length_unit] if scene.length_unit in METRES else diameter / PERSON


def render(
    scene: Scene, truth_chunks: Iterable[Truth | TimeGrid], config: RenderConfig, seed: int
) -> Iterator[Rendered]:
    """Render the video of every camera with a pose, frame by frame in the order of time.

    Cameras deliver frames at their own rates, or at every time of the truth.  The noise of
    a frame depends on seed, camera and frame number only.

    Args:
        scene: room, static occluders and cameras.
        truth_chunks: true paths of all people, in the order of time, as tables or grids; people face and step where
            they go.
        config: settings of noise, light and clothes.
        seed: seed of all random numbers.

    Returns:
        Generator of frames; InputError for a camera without an image size or a height above the floor.
    """
    metre = scene_metre(scene, config.diameter)
    numbers = [i for i, camera in enumerate(scene.cameras) if camera.placed]
    cameras = [_checked(scene.cameras[i]) for i in numbers]
    noise = generator(seed, RandomStream.RENDER_SENSOR).standard_normal(NOISE, dtype=np.float32)
    canvases = [canvas(scene, camera, metre, noise, config.texture) for camera in cameras]
    phase = generator(seed, RandomStream.RENDER_LIGHT).uniform(0.0, 2 * np.pi)
    sigmas = (config.noise, config.colour_noise)
    start_ns: int | None = None

    def render_shot(job: RenderJob) -> Rendered:
        rng = generator(seed, RandomStream.RENDER_SENSOR, numbers[job.number], job.frame)
        angle = 2 * np.pi * (job.t_ns - (start_ns or 0)) * 1e-9 / config.light_period_s + phase
        gain = 1.0 + config.light_drift * math.sin(angle)
        drawn = draw(
            c=canvases[job.number],
            rows=job.rows,
            clothes=job.clothes,
            gain=gain,
            sigmas=sigmas,
            shadows=config.shadows,
            rng=rng,
        )
        return _rendered(cameras[job.number], job, drawn, config)

    grids = walking(map(truth_grid, truth_chunks), metre)
    with ThreadPoolExecutor(config.workers) as pool:
        for grid, found in frames_at(grids, [camera.rate_hz for camera in cameras]):
            start_ns = int(grid.t_ns[0]) if start_ns is None else start_ns
            clothes = _clothes(grid.ids, grid.target, config, seed)
            for _, group in groupby(_jobs(found, grid.ids, clothes), key=lambda job: job.t_ns):
                jobs = list(group)
                if config.workers > 1:
                    yield from pool.map(render_shot, jobs)
                else:
                    yield from map(render_shot, jobs)


def _checked(camera: Camera) -> Camera:
    if camera.image_size is None:
        raise InputError(
            f"render: camera {camera.name} has no image size; give image_size_px in the scene", id="missing-image-size"
        )
    if not camera.above_floor:
        raise InputError(
            f"render: camera {camera.name} is {camera.position[2]:g} above the floor, must be above 0; "
            "give position: [x, y, z] in the scene",
        )
    return camera


def _clothes(ids: NDArray[np.int64], target: NDArray[np.bool_], config: RenderConfig, seed: int) -> Clothes:
    """Draw clothes for n objects; they depend on the seed, the numbers, and which objects are targets.

    `ids` (n,) are the numbers, `target` (n,) is the mask of targets.
    """
    targets = ids[target].tolist()
    worn = []
    for number, is_target in zip(ids.tolist(), target.tolist(), strict=True):
        model = number
        if config.identical_clothes and targets and not is_target:
            model = targets[number % len(targets)]
        if config.identical_targets and model in targets:
            model = targets[0]
        rank = targets.index(model) if model in targets else -1
        appearance = dress(
            rank, rank >= 0, generator(seed, RandomStream.RENDER_CLOTHES, model), two_sided=config.two_sided
        )
        worn.append(appearance)
    return clothes_of(worn)


def _jobs(found: list[SensorFrames], ids: NDArray[np.int64], clothes: Clothes) -> list[RenderJob]:
    """Frames to render in one chunk of truth, sorted by time and then by camera.

    Args:
        found: frames of each camera, with the positions of n objects.
        ids: (n,) numbers of the objects.
        clothes: clothes of the objects.
    """
    jobs = [
        RenderJob(int(t), number, appearance.first + k, appearance.xyz[k], ids, clothes)
        for number, appearance in enumerate(found)
        for k, t in enumerate(appearance.t_ns)
    ]
    return sorted(jobs, key=lambda job: (job.t_ns, job.number))


def _rendered(camera: Camera, job: RenderJob, drawn: RenderedFrame, config: RenderConfig) -> Rendered:
    share = drawn.visible[:, 4] / np.maximum(drawn.extent[:, 4], 1)
    shown = (drawn.extent[:, 4] > 0) & (share >= config.min_visibility)
    seen = shown & (drawn.visible[:, 4] > 0)
    ids = job.ids[drawn.present]
    boxes = _boxes(camera, job, ids[shown], drawn.extent[shown], share[shown])
    visible = _boxes(camera, job, ids[seen], drawn.visible[seen], share[seen])
    return Rendered(
        t_ns=job.t_ns,
        sensor=camera.name,
        index=job.frame,
        image=drawn.image,
        boxes=boxes,
        visible=visible,
        share=share[shown],
    )


def _boxes(
    camera: Camera, job: RenderJob, ids: NDArray[np.int64], pixels: NDArray[np.int64], share: Floats
) -> TruthBoxes:
    """Ground-truth boxes of one frame, rounded to whole pixels; one empty row for a frame without people.

    Args:
        camera: camera of the frame.
        job: time and number of the frame.
        ids: (m,) numbers of the people.
        pixels: (m, 5) left, top, right and bottom pixel, and a number of lines of sight that is not used.
        share: (m,) visible shares, 0 to 1.
    """
    if not len(ids):
        ids, pixels, share = np.array([-1]), np.full((1, 5), -1), np.array([np.nan])
        left = top = width = height = np.array([np.nan])
    else:
        left, top = pixels[:, 0] - 0.5, pixels[:, 1] - 0.5
        width, height = pixels[:, 2] - pixels[:, 0] + 1.0, pixels[:, 3] - pixels[:, 1] + 1.0
    n = len(ids)
    return TruthBoxes.of(
        t_ns=np.full(n, job.t_ns),
        sensor=np.full(n, camera.name),
        frame=np.full(n, job.frame),
        box=(np.arange(n) if ids[0] >= 0 else np.array([-1])).astype(np.int32),
        target_id=ids.astype(np.int32),
        left_px=left,
        top_px=top,
        width_px=width,
        height_px=height,
        confidence=np.full(n, np.nan),
        visible=share,
    )


SIZE = (160, 320)
DISTANCE = 4.0
FOCAL_PX = 560.0
SIDES = 8


def reference_appearances(
    scene: Scene, targets: Iterable[int], config: RenderConfig, seed: int, colours: bool = True
) -> list[dict[str, int | list[float]]]:
    """Appearance of each target: the colour histogram of its body seen from eight sides in the scene's light.

    Args:
        scene: scene with its lamps; the body stands below the first lamp.
        targets: numbers of the targets, ascending, as in the truth that is rendered.
        config: settings of the video.
        seed: seed of the video, which determines the clothes.
        colours: whether the video has colours; without, the histograms are of brightness alone.

    Returns:
        `[{"target_id": 0, "appearance": [72 numbers that sum to 1]}, ...]`
    """
    metre = scene_metre(scene, config.diameter)
    views = [_view(scene, metre, 2 * math.pi * side / SIDES) for side in range(SIDES)]
    found: list[dict[str, int | list[float]]] = []
    numbers = list(targets)
    for rank, target in enumerate(numbers):
        model, hue = (numbers[0], 0) if config.identical_targets else (target, rank)
        appearance = dress(hue, True, generator(seed, RandomStream.RENDER_CLOTHES, model), two_sided=config.two_sided)
        counts = np.zeros(N_BINS)
        for side, view in enumerate(views):
            _add_into(counts, view, clothes_of([appearance]), 2 * math.pi * side / SIDES, colours)
        found.append({"target_id": int(target), "appearance": normalised(counts).tolist()})
    return found


def _view(scene: Scene, metre: float, angle: float) -> tuple[Canvas, Floats]:
    """Canvas of a camera directed at the position under the first lamp, and that position (2,).

    The camera is at a fixed distance and points at the azimuth `angle` [rad]; `metre` is the length of a metre in scene
    units.
    """
    lights = lamps(scene.surroundings, scene.room_height)
    position = lights[0, :2]
    width, height = SIZE
    away = DISTANCE * metre * np.array([math.cos(angle), math.sin(angle)])
    camera = Camera(
        "reference",
        np.array([*(position - away), 0.5 * STATURE * metre]),
        rotation_from_angles(angle, 0.0, 0.0),
        np.array([FOCAL_PX, FOCAL_PX]),
        np.array([0.5 * (width - 1), 0.5 * (height - 1)]),
        image_size=SIZE,
    )
    return bare_canvas(camera, lights, metre), position


def _add_into(counts: Floats, view: tuple[Canvas, Floats], clothes: Clothes, phase: float, colours: bool) -> None:
    """Add the pixels of one rendered body, walking along x, to a colour histogram in place.

    Args:
        counts: (72,) histogram, updated.
        view: canvas, and position of the body (2,).
        clothes: clothes of the body.
        phase: phase of its gait [rad].
        colours: False: the image is converted to grey before.
    """
    sheet, position = view
    rows = np.array([[*position, WALKING, 0.0, phase]])
    image = draw(
        c=sheet, rows=rows, clothes=clothes, gain=1.0, sigmas=(0.0, 0.0), shadows=False, rng=np.random.default_rng(0)
    ).image
    mask = (image.max(axis=2) > 0).astype(np.uint8)
    add_pixels_into(counts, image if colours else grey(image), mask, 0, 0, *SIZE, 1.0)
