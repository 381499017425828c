"""Check of a camera's lens model in its image: whether it is invertible, and the valid part.

The models are those of `occlog.core.geometry.lens`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.core.geometry.lens import MAX_ANGLE, distort, fold_radius, is_usable, jacobian, undistort

COEFFICIENTS = {"brown": 5, "opencv": 14, "tsai": 5, "equidistant": 5}
"""Models, and how many coefficients each has."""
MAX_FISHEYE_DEG = float(np.degrees(MAX_ANGLE))
"""Angle to the optical axis [deg] up to which a fisheye is used."""
MAX_ROUND_TRIP_PX = 0.5
"""Largest difference of a pixel from that which its line of sight is projected to."""
GRID = 17
"""Pixels along each side of the image at which a lens is examined."""
FAR = 4.0
"""Radius up to which a fold is sought, in radii of the farthest pixel."""


class LensCheck(NamedTuple):
    """Result of `check_lens`: whether the lens model can be inverted in its image.

    Attributes:
        undone: the distortion is one-to-one in the image, or of a fisheye in the part within `MAX_FISHEYE_DEG`.
        fold_deg: angle to the optical axis [deg] at which a distortion that is not one-to-one folds back; NaN: unknown.
        unused: share of the image, 0 to 1, that is beyond `MAX_FISHEYE_DEG`.
    """

    undone: bool
    fold_deg: float = np.nan
    unused: float = 0.0


def check_lens(model: str, coefficients: Floats, size: tuple[int, int], focal: Floats, principal: Floats) -> LensCheck:
    """Check on a grid of pixels whether lens distortion is invertible: undistort, distort again, and compare.

    It is if all pixels return to within `MAX_ROUND_TRIP_PX` and the Jacobian's determinant is positive there. Of an
    equidistant fisheye it is determined which part of the image is usable.

    Args:
        model: `brown`, `opencv`, `tsai` or `equidistant`, as in `occlog.core.geometry.lens`.
        coefficients: as many as the model has (`COEFFICIENTS`).
        size: width and height of the image [px].
        focal: (2,) focal lengths [px].
        principal: (2,) principal point [px].
    """
    # Tsai's model gives the line of sight of a pixel directly; only the way back has to be solved.
    if model == "tsai" or (model != "equidistant" and not coefficients.any()):
        return LensCheck(True)
    u, v = np.meshgrid(np.linspace(0, size[0] - 1, GRID), np.linspace(0, size[1] - 1, GRID))
    bent = (np.column_stack([u.ravel(), v.ravel()]) - principal) / focal
    if model == "equidistant":
        usable = is_usable(bent, coefficients, model)
        return LensCheck(bool(usable.any()), unused=float(1.0 - usable.mean()))
    with np.errstate(all="ignore"):
        ideal = undistort(bent, coefficients, model)
        off = np.abs((distort(ideal, coefficients, model) - bent) * focal).max()
        regular = (np.linalg.det(jacobian(ideal, coefficients, model)) > 0.0).all()
    if off < MAX_ROUND_TRIP_PX and regular:
        return LensCheck(True)
    fold = fold_radius(coefficients, model, FAR * float(np.hypot(bent[:, 0], bent[:, 1]).max()))
    return LensCheck(False, float(np.degrees(np.arctan(fold))) if np.isfinite(fold) else np.nan)
