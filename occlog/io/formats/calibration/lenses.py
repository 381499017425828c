"""Lenses as files state them, to the models that a `Camera` has, checked in the image.

`OpenCV` writes 4 (fisheye), 5, 8 (rational), 12 (thin prism) or 14 (tilted sensor) coefficients, and most files do not
state which model they are of: four may be k1, k2, p1, p2 or those of a fisheye, which has to be stated.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError, option
from occlog.records.lens import COEFFICIENTS, MAX_FISHEYE_DEG, check_lens

COUNTS = (0, 1, 2, 3, 4, 5, 8, 12, 14)
"""Numbers of coefficients that a polynomial lens may have."""
LENS_MODELS = {"brown": "brown", "fisheye": "equidistant"}
"""Values of the setting `lens_model`, and the models."""


class Lens(NamedTuple):
    """Lens distortion as stated in a file.

    Attributes:
        model: `brown`, with 0 to 5, 8, 12 or 14 coefficients of OpenCV; `equidistant`, with 4; `tsai`, with 1; None:
            the file does not state it.
        coefficients: in OpenCV's order k1, k2, p1, p2, k3, ...; of `equidistant` k1 to k4; of `tsai` kappa1 f^2.
    """

    model: str | None = "brown"
    coefficients: Floats = np.zeros(0)


def read_lens(lens: Lens, wanted: str | None, where: str) -> Lens:
    """Lens with a model that a `Camera` has, and as many coefficients as the model has (padded with 0).

    Args:
        lens: as stated in the file.
        wanted: the user's model for files that do not state theirs, a key of `LENS_MODELS`; None: not given.
        where: file and camera, for messages.

    Raises:
        InputError: the model is ambiguous or contradicted, or the number of coefficients does not fit it.
    """
    given = np.asarray(lens.coefficients, dtype=np.float64).reshape(-1)
    if not np.isfinite(given).all():
        raise InputError(
            f"{where}: distortion {given.tolist()}; finite numbers were expected; calibrate again, from more images",
            id="invalid-calibration",
        )
    model = lens.model
    if model is None and wanted is not None:
        model = LENS_MODELS[wanted]
    if model is None and len(given) == 4 and given.any():
        raise InputError(
            f"{where}: 4 distortion coefficients, of a fisheye lens or k1, k2, p1, p2; state which: "
            f"{option('lens_model')} fisheye or brown, or fisheye_model: 1 or 0 in the file",
            id="ambiguous-input",
        )
    model = model or "brown"
    if wanted is not None and model in LENS_MODELS.values() and LENS_MODELS[wanted] != model:
        raise InputError(
            f"{where}: states another lens than {option('lens_model')} {wanted}; leave the option out",
            id="conflicting-values",
        )
    if model == "brown" and len(given) not in COUNTS and given[5:].any():
        raise InputError(
            f"{where}: {len(given)} distortion coefficients; OpenCV's lenses have 4, 5, 8, 12 or 14",
            id="invalid-calibration",
        )
    if model == "equidistant" and given[4:].any():
        raise InputError(
            f"{where}: {len(given)} distortion coefficients; a fisheye lens has 4", id="invalid-calibration"
        )
    if model == "brown" and given[5:].any():
        model = "opencv"
    coefficients = np.zeros(COEFFICIENTS[model])
    n = min(len(given), len(coefficients))
    coefficients[:n] = given[:n]
    return Lens(model, coefficients)


def checked_lens(
    lens: Lens, size: tuple[int, int], focal: Floats, principal: Floats, where: str
) -> tuple[str, Floats, str]:
    """Model and coefficients of a lens that can be inverted within the image, and a note (empty if there is none).

    A Brown lens for which fixed-point inversion fails (strong pincushion distortion) is converted to OpenCV's complete
    model, which Newton's method inverts.

    Args:
        lens: with as many coefficients as its model has.
        size: width and height of the image [px].
        focal: (2,) focal lengths [px].
        principal: (2,) principal point [px].
        where: file and camera, for messages.

    Raises:
        InputError: the lens folds inside the image.
    """
    model, coefficients = str(lens.model), lens.coefficients
    found = check_lens(model, coefficients, size, focal, principal)
    if model == "brown" and not found.undone:
        model, coefficients = "opencv", np.concatenate([coefficients, np.zeros(9)])
        found = check_lens(model, coefficients, size, focal, principal)
    if not found.undone:
        at = f" {found.fold_deg:.0f} degrees off the axis," if np.isfinite(found.fold_deg) else ""
        raise InputError(
            f"{where}: the distortion polynomial turns back{at} inside the image, and has no inverse there; "
            "use fewer coefficients, or undistort the images",
            id="invalid-calibration",
        )
    if not found.unused:
        return model, coefficients, ""
    return (
        model,
        coefficients,
        (
            f"the fisheye lens sees more than {MAX_FISHEYE_DEG:.0f} degrees off its axis; what lies beyond, "
            f"{found.unused:.0%} of the image, is not used"
        ),
    )


def stated_coefficients(model: str, coefficients: Floats, counts: Sequence[int], where: str) -> Floats:
    """Shortest list of coefficients, in OpenCV's order, by which a format can state a lens.

    Args:
        model: a key of `COEFFICIENTS`.
        coefficients: as many as the model has.
        counts: numbers of coefficients of a polynomial lens that the format supports, increasing.
        where: format and camera, for messages.

    Returns:
        All coefficients that are not 0, padded to one of `counts`; four of an equidistant lens.

    Raises:
        InputError: the format has no such lens.
    """
    if model == "equidistant":
        return np.asarray(coefficients[:4])
    needed = int(np.flatnonzero(coefficients)[-1]) + 1 if coefficients.any() else 0
    count = next((n for n in counts if n >= needed), None)
    if count is None or (model == "tsai" and needed):
        of = "Tsai's lens" if model == "tsai" else f"a lens with {needed} coefficients of OpenCV's"
        remedy = "undistort the images" if model == "tsai" else "write opencv-storage"
        raise InputError(
            f"{where}: this format cannot state {of}; {remedy}, or a scene (.yaml)", id="unsupported-format"
        )
    return np.concatenate([coefficients, np.zeros(14)])[:count]
