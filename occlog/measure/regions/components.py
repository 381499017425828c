"""Connected components of the foreground as person-sized regions: the plain alternative to clustering."""

from __future__ import annotations

import cv2
import numpy as np

from occlog.array_types import Bytes, Floats, Ints, Ints32
from occlog.core.image.histogram_bins import N_BINS, as_colour, pixel_bin
from occlog.core.numerics.jit import kernel
from occlog.measure.clusters.person_size import Prior, place

from .appearance import normalised
from .regions import Regions

CLOSING = 0.2  # side of the closing that joins pieces, over a person's width


def component_regions(image: Bytes, mask: Bytes, width_px: float, prior: Prior) -> Regions:
    """The connected components of a frame that have enough foreground for a person.

    Pieces nearer than about a fifth of a person's width are joined first.  People who
    touch in the image are one region; a person in several pieces is several, or none.

    Args:
        image: (height, width, 3) BGR or (height, width) grey.
        mask: (height, width), 255 on the foreground.
        width_px: of a person.
        prior: of the camera; of it only the sizes and the smallest share of a person are used.
    """
    side = 2 * round(0.5 * CLOSING * width_px) + 1
    joined = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((side, side), np.uint8)) if side > 1 else mask
    _, labels, stats, centres = cv2.connectedComponentsWithStats(joined, connectivity=8)
    order = np.argsort(-stats[1:, cv2.CC_STAT_AREA], kind="stable") + 1
    places = np.array([place(prior, *centres[k]) for k in order], dtype=np.int64)
    enough = stats[order, cv2.CC_STAT_AREA] >= prior.least * prior.mass[places]
    order, places = order[enough], places[enough]
    edges = stats[order, :4].astype(np.int64)
    moments, counts = _measure(as_colour(image), mask, labels, order.astype(np.int64), edges)
    return _regions(moments, counts, edges, prior.cov[places], prior.mass[places])


def _regions(moments: Floats, counts: Floats, edges: Ints, person: Floats, person_mass: Floats) -> Regions:
    mass = moments[:, 0]
    boxes = edges - np.array([0.5, 0.5, 0.0, 0.0])
    order = np.argsort(-mass, kind="stable")
    order = order[mass[order] > 0]
    covs = moments[:, 3:] / np.maximum(mass, 1.0)[:, None]
    appearance = normalised(counts)
    return Regions(
        means=moments[order, 1:3],
        covs=covs[order],
        boxes=boxes[order],
        mass=mass[order],
        fill=mass[order] / person_mass[order],
        person=person[order],
        appearance=appearance[order],
    )


@kernel
def _measure(image: Bytes, mask: Bytes, labels: Ints32, wanted: Ints, edges: Ints) -> tuple[Floats, Floats]:
    """Count, mean and scatter (K, 6) and histograms (K, 72) of the foreground of labelled components.

    Args:
        image: (height, width, 3) BGR.
        mask: (height, width), non-zero on the foreground.
        labels: (height, width) component of each pixel.
        wanted: (K,) components to measure.
        edges: (K, 4) left, top, width, height of their boxes, inside the image.
    """
    n_regions = wanted.shape[0]
    moments, counts = np.zeros((n_regions, 6)), np.zeros((n_regions, N_BINS))
    for k in range(n_regions):
        left, top, width, height = edges[k]
        n = sx = sy = xx = xy = yy = 0
        for y in range(height):
            for x in range(width):
                py, px = top + y, left + x
                if labels[py, px] == wanted[k] and mask[py, px]:
                    n += 1
                    sx += x
                    sy += y
                    xx += x * x
                    xy += x * y
                    yy += y * y
                    counts[k, pixel_bin(int(image[py, px, 0]), int(image[py, px, 1]), int(image[py, px, 2]))] += 1.0
        if n > 0:
            mx, my = sx / n, sy / n
            moments[k, 0], moments[k, 1], moments[k, 2] = n, left + mx, top + my
            moments[k, 3], moments[k, 4], moments[k, 5] = xx - n * mx * mx, xy - n * mx * my, yy - n * my * my
    return moments, counts
