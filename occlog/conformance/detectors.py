"""The kit of detectors: each check tries one promise with drawn images, and states in a sentence how it is broken."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from occlog.measure.detect.by_plugin import fault_of
from occlog.plugins.interface import Detected, Image

from .faults import FIRST, BrokenError, Check, called, defaults, manners, named, refuse

GROWTH_BYTES = 4_000
"""Memory that a film of a few images may leave behind."""
SIZE = (120, 160)
"""Height and width of the images [px]."""


def image(k: int, size: tuple[int, int] = SIZE) -> Image:
    """Return frame `k` of a sample film: two bright figures that walk through a grey room with noise.

    `size`: height and width [px]. The image is (height, width, 3), BGR, uint8; the same `k` always gives the same
    image.
    """
    high, wide = size
    rng = np.random.default_rng(k)
    out = rng.normal(60.0, 3.0, (high, wide, 3))
    for position in (0.2 + 0.02 * k, 0.8 - 0.02 * k):
        left = int(position * wide)
        out[int(0.3 * high) : int(0.9 * high), left : left + max(wide // 10, 1)] = (210.0, 220.0, 230.0)
    return np.clip(np.round(out), 0, 255).astype(np.uint8)


def film(of: Any, images: Iterable[Image], what: str = "detect", *, own: Any = None) -> list[Detected]:
    """Run a detector of class `of` on images, and return its detections in each.

    Args:
        of: class of the plug-in.
        images: frames in the order of time.
        what: words for the call in messages.
        own: detector to continue with; None: a new one.

    Raises:
        BrokenError: the detector raises, or returns impossible boxes.
    """
    with called("a new detector"):
        seeing = start(of) if own is None else own
    found = []
    for each in images:
        with called(what):
            found.append(seeing.detect(each))
        refuse(fault_of(found[-1]), "" if what == "detect" else what)
    return found


def start(of: Any, seed: int = 1) -> Any:
    """Return a new detector of class `of` with its default settings and random numbers of `seed`."""
    return of(defaults(of), np.random.default_rng(seed))


def as_bytes(found: Iterable[Detected]) -> list[tuple[bytes, ...]]:
    """Return boxes, scores and embeddings of each image as bytes of float64, for an exact comparison."""
    values = [(each.boxes, each.scores, () if each.embeddings is None else each.embeddings) for each in found]
    return [tuple(np.asarray(v, dtype=np.float64).tobytes() for v in each) for each in values]


def use(of: Any) -> list[tuple[bytes, ...]]:
    """Run the detector class `of` on four images; return its detections as bytes (`as_bytes`)."""
    return as_bytes(film(of, (image(k) for k in range(4))))


def _refuse(of: Any, *starts: str, rest: bool = False) -> None:
    """Raise BrokenError if the detections in four frames have a fault, the text of which begins with one of `starts`.

    With `rest` it is raised for a fault, the text of which begins with none of them. A detector that raises an error
    passes here, since other checks report that.
    """
    try:
        own = start(of)
        found = [own.detect(image(k)) for k in range(4)]
    except Exception:
        return
    for each in found:
        wrong = fault_of(each)
        if wrong is not None and wrong.startswith(starts) != rest:
            raise BrokenError(wrong)


def check_shape(of: Any) -> None:
    """Check that `detect` returns a `Detected` with a score for each box."""
    _refuse(of, "boxes are not finite", "embeddings are not finite", "box ", "score ", rest=True)


def check_finite(of: Any) -> None:
    """Check that the boxes and embeddings which a detector returns are finite numbers."""
    _refuse(of, "boxes are not finite", "embeddings are not finite")


def check_sizes(of: Any) -> None:
    """Check that widths and heights of the returned boxes are above 0."""
    _refuse(of, "box ")


def check_scores(of: Any) -> None:
    """Check that the returned scores are from 0 to 1."""
    _refuse(of, "score ")


def check_inside(of: Any) -> None:
    """Check that every box overlaps the image.

    Edges must be pixels of the given image, not fractions or pixels of a resized one.
    """
    high, wide = SIZE
    for each in film(of, (image(k) for k in range(4))):
        for left, top, width, height in np.asarray(each.boxes, dtype=np.float64).reshape(-1, 4).tolist():
            if left >= wide or top >= high or left + width <= -0.5 or top + height <= -0.5:
                raise BrokenError(
                    f"the detector gives a box at {left:.0f},{top:.0f} of {width:.0f} x {height:.0f} px, outside its "
                    f"image of {wide} x {high} px; give pixels of the image"
                )


def check_embeddings(of: Any) -> None:
    """Check that embeddings are of one length in all images."""
    found = film(of, (image(k) for k in range(4)))
    without_embeddings = {each.embeddings is None for each in found}
    lengths = {np.shape(each.embeddings)[1] for each in found if each.embeddings is not None and len(each.boxes)}
    if len(without_embeddings) > 1 or len(lengths) > 1:
        raise BrokenError(
            "the detector's embeddings have different lengths in images of one video, or only some images have any"
        )


def check_independent(of: Any) -> None:
    """Check that detectors of several cameras do not influence each other."""
    alone = film(of, (image(k) for k in range(4)))
    with called("a new detector"):
        first, second = start(of), start(of)
    both = []
    for k in range(4):
        both += film(of, [image(k)], own=first)
        film(of, [image(k)[:, ::-1].copy()], own=second)
    if as_bytes(alone) != as_bytes(both):
        raise BrokenError(
            "the detector's boxes depend on another camera's images; keep state in the object, not in class or module"
        )


def check_inputs(of: Any) -> None:
    """Check that a detector leaves the given image unchanged."""
    for k in range(4):
        given = image(k)
        film(of, [given])
        if (given != image(k)).any():
            raise BrokenError("the detector's detect changes the image that it is given; copy it")


def check_results(of: Any) -> None:
    """Check that returned arrays do not change at later calls."""
    with called("a new detector"):
        own = start(of)
    kept = []
    for k in range(6):
        (found,) = film(of, [image(k)], own=own)
        kept.append((found, as_bytes([found])))
    if any(as_bytes([found]) != was for found, was in kept):
        raise BrokenError("the detector changes boxes that it has returned; return copies")


def check_read_only(of: Any) -> None:
    """Check that a detector accepts an image in a read-only array."""
    given = image(0)
    given.flags.writeable = False
    film(of, [given], "an image that is read only: detect")


def check_strided(of: Any) -> None:
    """Check that an image that is not contiguous in memory gives the same boxes as its copy."""
    wide = np.zeros((SIZE[0], 2 * SIZE[1], 3), dtype=np.uint8)
    wide[:, ::2] = image(1)
    if as_bytes(film(of, [wide[:, ::2]], "an image with gaps in memory: detect")) != as_bytes(film(of, [image(1)])):
        raise BrokenError(
            "the detector finds other boxes in a strided (non-contiguous) image; read its values, not its bytes"
        )


def check_empty(of: Any) -> None:
    """Check that a detector accepts images of one colour, in which no person is present."""
    for value in (0, 128, 255):
        film(of, [np.full((*SIZE, 3), value, dtype=np.uint8)], f"an image of the colour {value}: detect")


def check_noise(of: Any) -> None:
    """Check that a detector accepts images of noise."""
    rng = np.random.default_rng(9)
    film(of, [rng.integers(0, 256, (*SIZE, 3)).astype(np.uint8)], "an image of noise: detect")


def check_small(of: Any) -> None:
    """Check that a detector accepts small images of any shape."""
    for size in ((16, 24), (241, 63)):
        film(of, [image(0, size)], f"an image of {size[1]} x {size[0]} px: detect")


CHECKS: dict[str, Check] = {
    **FIRST,
    **named(globals()),
    **manners(use, "detect", growth_bytes=GROWTH_BYTES),
}
"""Every check by its name."""
