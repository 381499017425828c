"""What the targets look like: appearance histograms of their bodies rendered alone, for the detector."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from occlog.array_types import Floats
from occlog.core.image.histogram_bins import N_BINS
from occlog.core.numerics.seeds import Stage, generator
from occlog.core.sight.camera import rotation_from_angles
from occlog.measure.regions.appearance import add_pixels_into, normalised
from occlog.records.scene import Camera, Scene
from occlog.simulate.config import RenderConfig

from .body import STATURE, WALKING, Clothes, clothes_of, dress
from .frame import Canvas, bare_canvas, draw
from .light import lamps
from .people import scene_metre

SIZE = (160, 320)
DISTANCE = 4.0
FOCAL_PX = 560.0
SIDES = 8


def reference_appearances(
    scene: Scene, targets: Iterable[int], config: RenderConfig, seed: int
) -> list[dict[str, int | list[float]]]:
    """Appearance of each target: the histogram of its body as seen from eight sides in the scene's light.

    Args:
        scene: its lamps light the body, which stands where the first lamp hangs.
        targets: numbers of the targets, rising, as in the truth that is rendered.
        config: as for `render`.
        seed: as for `render`; it decides on the clothes.

    Returns:
        `[{"target_id": 0, "appearance": [72 numbers that sum to 1]}, ...]`
    """
    metre = scene_metre(scene, config.diameter)
    views = [_view(scene, metre, 2 * math.pi * side / SIDES) for side in range(SIDES)]
    found: list[dict[str, int | list[float]]] = []
    numbers = list(targets)
    for rank, target in enumerate(numbers):
        model, hue = (numbers[0], 0) if config.alike else (target, rank)
        look = dress(hue, True, generator(seed, Stage.RENDER_CLOTHES, model), two_sided=config.two_sided)
        counts = np.zeros(N_BINS)
        for side, view in enumerate(views):
            _add_into(counts, view, clothes_of([look]), 2 * math.pi * side / SIDES)
        found.append({"target_id": int(target), "appearance": normalised(counts).tolist()})
    return found


def _view(scene: Scene, metre: float, angle: float) -> tuple[Canvas, Floats]:
    """A camera that looks from a distance at the place under the first lamp, and that place (2,)."""
    lights = lamps(scene.surroundings, scene.room_height)
    place = lights[0, :2]
    width, height = SIZE
    away = DISTANCE * metre * np.array([math.cos(angle), math.sin(angle)])
    camera = Camera(
        "reference",
        np.array([*(place - away), 0.5 * STATURE * metre]),
        rotation_from_angles(angle, 0.0, 0.0),
        np.array([FOCAL_PX, FOCAL_PX]),
        np.array([0.5 * (width - 1), 0.5 * (height - 1)]),
        image_size=SIZE,
    )
    return bare_canvas(camera, lights, metre), place


def _add_into(counts: Floats, view: tuple[Canvas, Floats], clothes: Clothes, phase: float) -> None:
    """Add the pixels of one body, walking along x, to a histogram."""
    sheet, place = view
    rows = np.array([[*place, WALKING, 0.0, phase]])
    image = draw(
        c=sheet, rows=rows, clothes=clothes, gain=1.0, sigmas=(0.0, 0.0), shadows=False, rng=np.random.default_rng(0)
    ).image
    mask = (image.max(axis=2) > 0).astype(np.uint8)
    add_pixels_into(counts, image, mask, 0, 0, *SIZE, 1.0)
