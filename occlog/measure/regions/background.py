"""Background subtraction with OpenCV's MOG2 and KNN, empty scene estimation, and sizes of people from blobs.

OpenCV's automatic learning rate starts high (1 / (2 n) after n frames), so that a model with few frames absorbs people
into the background. A model can therefore be started from an image of the empty scene; it then learns at the rate 1 /
history from its first frame on.

Empty scene, from frames sampled over a recording: a plain median over time would show a person who stays in one
position. Here samples are excluded from a pixel's median if the picture around the pixel changes towards the previous
or next sample, i.e. where something moves.

Height of people in the image: in each sample, differences from the empty scene are joined over gaps of an eighth of
their height; a blob is a separate person if it is 1.5 to 4.5 times as high as wide, fills 35 to 95 % of its box, is at
least 24 px high and does not touch the image border. On level ground the height is linear in the row of the feet; a
line is fitted by Theil-Sen. With fewer than ten blobs, or feet in nearly the same rows, the height is their median
everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np

from occlog.array_types import Bytes, Floats
from occlog.core.numerics.jit import kernel
from occlog.measure.clusters.person_size import LOG_SIZE_SPREAD, SizeMap, cell_centres, sizes_from_heights

FOREGROUND = 255  # OpenCV marks shadows with 127
DEFAULT_THRESHOLD = {"mog2": 36.0, "knn": 800.0}
"""Above OpenCV's 16 and 400: clouds brighten a wall by more than that within seconds."""

LARGEST_IMAGE, LARGEST_KNN = 34_000_000, 25_000_000
"""Pixels of an image.

The models take 100 and 84 bytes for each, and OpenCV counts those of KNN in 32 bits: larger ones end the process.
"""

KNN_START_FRAMES = 30  # fills the short, middle and long sample sets of the KNN model


@dataclass(frozen=True)
class Subtractor:
    """Background model of one camera; `foreground` updates it.

    `rate` is the learning rate per frame, negative for OpenCV's automatic one; `seed` that of KNN's random numbers;
    `shadows`: the model marks shadows.
    """

    model: cv2.BackgroundSubtractor
    rate: float  # learning rate; negative: OpenCV's automatic one
    seed: int
    shadows: bool = False


def make_subtractor(
    kind: str, history: int, threshold: float | None, shadows: bool, start: Bytes | None = None, seed: int = 0
) -> Subtractor:
    """Create a background model.

    Args:
        kind: `mog2` or `knn`.
        history: number of frames that the model remembers; a motionless person
            becomes background after about a tenth of it.
        threshold: squared distance of a pixel from the background, for MOG2 in units of
            the background's variance, for KNN in squared grey levels; None: the default.
        shadows: distinguish shadows from foreground.
        start: image of the empty scene to start from; None: learn from the first frames.
        seed: of KNN's random choice of samples (MOG2 has none).

    Raises:
        ValueError: the kind is not known.
    """
    if kind not in DEFAULT_THRESHOLD:
        raise ValueError(f"background model {kind!r} is not one of: {', '.join(DEFAULT_THRESHOLD)}")
    make = cv2.createBackgroundSubtractorMOG2 if kind == "mog2" else cv2.createBackgroundSubtractorKNN
    model = make(history, DEFAULT_THRESHOLD[kind] if threshold is None else threshold, shadows)
    if start is None:
        return Subtractor(model, -1.0, seed, shadows)
    cv2.setRNGSeed(seed)
    model.apply(start, learningRate=1.0)
    for _ in range(KNN_START_FRAMES if kind == "knn" else 0):
        model.apply(start, learningRate=0.5)
    return Subtractor(model, 1.0 / history, seed, shadows)


def largest_image(kind: str) -> int:
    """Maximum number of pixels of an image for a background model of the kind `mog2` or `knn`."""
    return LARGEST_KNN if kind == "knn" else LARGEST_IMAGE


MAX_SPREAD = 2
"""Difference [grey levels] of the channels of a pixel without colour."""
COLOURED_SHARE = 1e-3
"""Share of pixels with colour that make an image one in colour."""
COLOUR_STEP = 4
"""Every so many rows and columns are searched for colours."""
ROUGHNESS = 0.12
"""Standard deviation over 3 x 3 pixels of the log ratio to the empty scene, above which a darker pixel is no shadow."""
NEAR_PX, STREAK_PX = 7, 4
"""Rough pixels count near foreground alone; lower streaks are edges of shadows, smaller gaps are filled [px]."""


def has_colours(image: Bytes) -> bool:
    """Whether an image (height, width, 3) or (height, width) has colours."""
    if image.ndim == 2:
        return False
    few = image[::COLOUR_STEP, ::COLOUR_STEP].astype(np.int16)
    return bool(np.mean(few.max(axis=2) - few.min(axis=2) > MAX_SPREAD) > COLOURED_SHARE)


def without_grey_shadows(marked: Bytes, image: Bytes, empty: Bytes) -> Bytes:
    """(height, width) foreground mask (255, else 0) of an image without colours, with shadows removed.

    OpenCV detects shadows by colour, and without colours takes every darker pixel for one. Here a darker pixel is a
    shadow if its ratio to the empty scene is smooth; clothes and limbs are not.

    Args:
        marked: (height, width) output of the background model: 255 foreground, 127 darker, 0 background.
        image: (height, width, 3) or (height, width).
        empty: image of the empty scene, of the same height and width.
    """
    now, scene = (each if each.ndim == 2 else each[:, :, 0] for each in (image, empty))
    log_ratio = np.log((now + np.float32(1.0)) / (scene + np.float32(1.0)))
    mean, square = (cv2.blur(each, (3, 3)) for each in (log_ratio, log_ratio * log_ratio))
    darker, sure = (marked > 0) & (marked < FOREGROUND), (marked == FOREGROUND).astype(np.uint8)
    near = cv2.dilate(sure, np.ones((NEAR_PX, NEAR_PX), np.uint8)) > 0
    rough = darker & (square - mean * mean > ROUGHNESS**2)
    mask = np.where(rough & near, FOREGROUND, FOREGROUND * sure).astype(np.uint8)
    mask = _dilated(_eroded(mask, 1, STREAK_PX), 1, STREAK_PX)
    closed = [_eroded(_dilated(mask, *sides), *sides) for sides in ((1, STREAK_PX), (STREAK_PX, 1))]
    filled: Bytes = np.where(darker & ((closed[0] | closed[1]) > 0), FOREGROUND, mask).astype(np.uint8)
    return filled


def _eroded(mask: Bytes, columns: int, rows: int) -> Bytes:
    """Minimum filter (erosion) of a mask over a rectangle of `columns` x `rows` pixels.

    For even sizes its centre is the mirror image of that of the dilation here, so that both in turn shift nothing.
    """
    anchor = ((columns - 1) // 2, (rows - 1) // 2)
    return cv2.erode(mask, np.ones((rows, columns), np.uint8), anchor=anchor)  # type: ignore[no-any-return]


def _dilated(mask: Bytes, columns: int, rows: int) -> Bytes:
    """Maximum filter (dilation) of a mask over a rectangle of `columns` x `rows` pixels.

    For even sizes its centre is the mirror image of that of the erosion here, so that both in turn shift nothing.
    """
    anchor = (columns // 2, rows // 2)
    return cv2.dilate(mask, np.ones((rows, columns), np.uint8), anchor=anchor)  # type: ignore[no-any-return]


def foreground(subtractor: Subtractor, image: Bytes, number: int, clean_px: int) -> Bytes:
    """Update a background model by an image; return its foreground mask (height, width): 255, else 0 (also shadows).

    Args:
        subtractor: background model of the camera; frames must come in order.
        image: (height, width, 3) BGR or (height, width) grey, always of one size.
        number: number of the frame; with the model's seed it determines KNN's random numbers, so that they do not
            depend on the thread that does the work.
        clean_px: side of the median filter that removes speckle, odd; 0 or 1: none.
    """
    cv2.setRNGSeed((subtractor.seed + number) & 0x7FFFFFFF)
    raw = subtractor.model.apply(image, learningRate=subtractor.rate)
    if subtractor.shadows and not has_colours(image):
        mask = without_grey_shadows(raw, image, subtractor.model.getBackgroundImage())
    else:
        # Shadows (127) go to background.
        _, mask = cv2.threshold(raw, FOREGROUND - 1, FOREGROUND, cv2.THRESH_BINARY)
    if clean_px > 1:
        mask = cv2.medianBlur(mask, clean_px)
    return mask


CHANGE = 12.0  # grey levels between two samples that mean motion, after smoothing
SMOOTHING_PX = 0.7  # more hides the edges of slow bodies
COARSE_THICKNESS_PX = 30.0  # bodies are thinned to this before their edges are sought
MAX_SAMPLES = 64  # size of the kernel's scratch space


def motion_masks(samples: Bytes, thickness_px: float) -> Bytes:
    """(n, height, width) masks of n samples: 1 where something moves, 0 where the image is static.

    Args:
        samples: (n, height, width[, channels]) images in the order of time.
        thickness_px: bodies up to this thickness are filled between their moving edges.
    """
    # Edges of motion need no fine grid: thick bodies are filled in a coarser one.
    coarse = max(1, int(thickness_px / COARSE_THICKNESS_PX))
    height, width = samples.shape[1:3]
    size = (max(1, width // coarse), max(1, height // coarse))
    smooth = [
        cv2.GaussianBlur(cv2.resize(s, size, interpolation=cv2.INTER_AREA), (0, 0), SMOOTHING_PX) for s in samples
    ]
    changed = np.stack([(difference(a, b) > CHANGE).astype(np.uint8) for a, b in pairwise(smooth)])
    moving = np.concatenate([changed[:1], changed[:-1] | changed[1:], changed[-1:]])
    side = 2 * round(thickness_px / coarse / 2) + 1
    square = np.ones((side, side), np.uint8)
    closed = [cv2.morphologyEx(m, cv2.MORPH_CLOSE, square) for m in moving]
    return np.stack([cv2.resize(m, (width, height), interpolation=cv2.INTER_NEAREST) for m in closed])


def empty_scene(samples: list[Bytes], thickness_px: float) -> Bytes:
    """Image of the empty scene: per pixel the median of its samples without motion.

    The first `MAX_SAMPLES` samples are used; of fewer than three the first is returned.

    Args:
        samples: at least one image (height, width, 3) or (height, width), all of one size, in the order of time.
        thickness_px: thickness of a person in the image.

    Returns:
        Image like the samples.  A pixel with motion in all samples gets the median of all: something that is always
        there and always moves stays in the picture.
    """
    if len(samples) < 3:
        return samples[0].copy()
    stack = np.stack(samples[:MAX_SAMPLES])
    masks = motion_masks(stack, thickness_px)
    shape = stack.shape[1:]
    return _masked_median(stack.reshape(len(stack), shape[0] * shape[1], -1), masks.reshape(len(stack), -1)).reshape(
        shape
    )


@kernel
def _masked_median(samples: Bytes, masks: Bytes) -> Bytes:
    """(pixels, channels) lower median over n samples (n, pixels, channels) where `masks` (n, pixels) are 0.

    A pixel with no 0 in its mask gets the median of all samples.
    """
    n, pixels, channels = samples.shape
    out = np.empty((pixels, channels), dtype=np.uint8)
    values = np.empty(n, dtype=np.uint8)
    for p in range(pixels):
        quiet = 0
        for i in range(n):
            quiet += masks[i, p] == 0
        for c in range(channels):
            count = 0
            for i in range(n):
                if quiet == 0 or masks[i, p] == 0:
                    # Insertion sort: n is small.
                    j = count
                    while j > 0 and values[j - 1] > samples[i, p, c]:
                        values[j] = values[j - 1]
                        j -= 1
                    values[j] = samples[i, p, c]
                    count += 1
            out[p, c] = values[(count - 1) // 2]
    return out


def difference(a: Bytes, b: Bytes) -> Bytes:
    """(height, width) maximum absolute difference over the channels of two images a and b of one shape."""
    change = cv2.absdiff(a, b)
    if change.ndim == 2:
        return change  # type: ignore[no-any-return]
    blue, green, red = cv2.split(change)
    return cv2.max(cv2.max(blue, green), red)  # type: ignore[no-any-return]


DIFFERENCE = 30  # grey levels from the empty scene that mean foreground
ASPECT = (1.5, 4.5)
FILLED = (0.35, 0.95)
MIN_HEIGHT_PX = 24
ENOUGH_BLOBS = 10
ROW_RANGE = 0.1  # of the image's height between the rows of the feet that allow a line
CLOSINGS = (3, 7, 15)  # sides tried for joining pieces [px]; the one with most people-like blobs is used


def person_like_blobs(samples: list[Bytes], empty: Bytes) -> Floats:
    """(N, 2) row of the feet and height [px] of blobs with the shape of a separate person in all samples.

    Blobs are differences from `empty`, the image without people, of the shape of the samples; the size of the closing
    that joins their pieces is the one of `CLOSINGS` that gives most of them.
    """
    return max((_blobs(samples, empty, side) for side in CLOSINGS), key=len)


def _blobs(samples: list[Bytes], empty: Bytes, side: int) -> Floats:
    found = [_blobs_of(sample, empty, side) for sample in samples]
    return np.concatenate(found) if found else np.empty((0, 2))


def _blobs_of(sample: Bytes, empty: Bytes, side: int) -> Floats:
    mask = cv2.medianBlur((difference(sample, empty) > DIFFERENCE).astype(np.uint8), 5)
    mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((side, side), np.uint8))
    _, _, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    left, top, width, height, area = stats[1:].T.astype(np.float64)
    rows, columns = mask.shape
    aspect, filled = height / width, area / (width * height)
    inside = (left > 0) & (top > 0) & (left + width < columns) & (top + height < rows)
    person = inside & (aspect >= ASPECT[0]) & (aspect <= ASPECT[1]) & (filled >= FILLED[0]) & (filled <= FILLED[1])
    person &= height >= MIN_HEIGHT_PX
    blobs: Floats = np.column_stack([top + height, height])[person]
    return blobs


def observed_sizes(image_size: tuple[int, int], blobs: Floats) -> SizeMap | None:
    """Size map from blobs of people in images of one size; None without blobs.

    The height is linear in the row of the feet, or constant if the blobs are few or in a small range of rows.

    Args:
        image_size: width and height of the images [px].
        blobs: (N, 2) row of the feet, and height, of each blob [px].
    """
    if not len(blobs):
        return None
    feet, heights = blobs.T
    slope, at_top = _line(feet, heights) if _allow_line(feet, image_size[1]) else (0.0, float(np.median(heights)))
    _, centres = cell_centres(image_size)
    # A person centred in row v has its feet at v + h / 2, so h = at_top + slope (v + h / 2).
    fitted = (at_top + slope * centres[:, 1]) / (1.0 - 0.5 * slope)
    fitted = np.clip(fitted, 0.5 * heights.min(), 2.0 * heights.max())
    residuals = np.log(heights / np.maximum(at_top + slope * feet, 1.0))
    spread = 1.4826 * float(np.median(np.abs(residuals - np.median(residuals))))
    return sizes_from_heights(image_size, fitted, max(spread, LOG_SIZE_SPREAD))


def _allow_line(feet: Floats, rows: int) -> bool:
    return len(feet) >= ENOUGH_BLOBS and float(np.ptp(np.percentile(feet, [10, 90]))) >= ROW_RANGE * rows


def _line(x: Floats, y: Floats) -> tuple[float, float]:
    """Theil-Sen line of y (n,) over x (n,): slope, limited to [0, 1], and intercept.

    Pairs with x at most 1 apart are not used.
    """
    dx, dy = x[:, None] - x, y[:, None] - y
    separated = dx > 1.0
    slope = float(np.clip(np.median(dy[separated] / dx[separated]), 0.0, 1.0))
    return slope, float(np.median(y - slope * x))
