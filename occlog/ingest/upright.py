"""Turns the world of a calibration upright: z up, the ground at z = 0.

Azimuths, fields of view and sizes of people mean something in an upright world only.  Calibrations of stereo rigs and
with boards often have the world at a camera or at the board.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.core.sight.upright import seems_upright, turn_upright, vertical
from occlog.errors import InputError, UsageError
from occlog.records.scene import HEIGHT_SLACK, Camera, camera_fov
from occlog.records.tables import Truth

AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
AUTO = "auto"


class Turn(NamedTuple):
    """How a calibration's world was turned: p becomes R p - (0, 0, ground)."""

    rotation: Floats  # (3, 3)
    ground: float  # height of the ground after the rotation

    def places(self, xyz: Floats) -> Floats:
        """(N, 3) places in the upright world."""
        return np.asarray(xyz @ self.rotation.T - [0.0, 0.0, self.ground])

    def camera(self, camera: Camera) -> Camera:
        """The camera in the upright world."""
        rotation = self.rotation @ camera.rotation
        fov = camera.fov
        if camera.image_size is not None:
            fov = camera_fov(
                camera.image_size,
                camera.focal_px,
                camera.principal_px,
                distortion=camera.distortion,
                model=camera.distortion_model,
                rotation=rotation,
            )
        position = self.places(camera.position[None])[0]
        if abs(position[2]) <= HEIGHT_SLACK:
            # At the ground but for the rounding of the calibration: its height is unknown
            position[2] = 0.0
        return replace(camera, position=position, rotation=rotation, fov=fov)

    def truth(self, truth: Truth, path: Path) -> Truth:
        """True places in the upright world; InputError for one without a height, which could be anywhere there."""
        if np.isnan(truth.z).any():
            raise InputError(f"{path}: has no heights, without which true positions cannot be turned upright; add z")
        x, y, z = self.places(np.column_stack([truth.x, truth.y, truth.z])).T
        columns = {c.name: getattr(truth, c.name) for c in Truth.columns()}
        return Truth(**(columns | {"x": x.copy(), "y": y.copy(), "z": z.copy()}))

    def parameters(self) -> dict[str, object]:
        """For provenance."""
        return {"turned_by": self.rotation.tolist(), "ground": self.ground}


def find_turn(
    cameras: Sequence[Camera], up: str | None, ground: float | None, note: Callable[[str], None]
) -> Turn | None:
    """How to turn the world of calibrated cameras; None: not at all.

    Args:
        cameras: as calibrated.
        up: `auto`, an axis with its sign, three numbers, or None: it stays, with a warning if it seems not upright.
        ground: height of the ground along up, in the calibration's world; None: 0.
        note: is told what was done.

    Raises:
        UsageError: `up` is nothing of that.
    """
    rotations = np.array([c.rotation for c in cameras]).reshape(-1, 3, 3)
    if up is None:
        upright = seems_upright(rotations)
        if not upright:
            note(
                f"warning: the world of the calibration seems not to be upright: {_horizons(rotations)}. "
                "Directions in its xy plane mean nothing then; turn it (up: auto, or the direction that is up)"
            )
        stays = Turn(np.eye(3), 0.0 if ground is None else ground)
        if upright or ground is not None:
            _warn_of_low(cameras, stays, ground, note)
        return None if ground is None else stays
    if up == AUTO:
        found = vertical(rotations)
        direction = found.up
        if not found.certain:
            note("warning: the cameras look the same way, so that up is only known to their pitch; it was taken for 0")
    else:
        direction = read_up(up)
    turn = Turn(turn_upright(direction), 0.0 if ground is None else ground)
    text = ", ".join(f"{v:.3f}" for v in direction / np.linalg.norm(direction))
    zero = "at the calibration's origin" if ground is None else f"{ground:g} m along it"
    note(f"world turned upright: up was ({text}), the ground is {zero}")
    _warn_of_low(cameras, turn, ground, note)
    return turn


def _warn_of_low(cameras: Sequence[Camera], turn: Turn, ground: float | None, note: Callable[[str], None]) -> None:
    """Warn where cameras are not above the ground."""
    heights = {c.name: float(turn.places(c.position[None])[0, 2]) for c in cameras if c.placed}
    low = [name for name, height in heights.items() if height <= HEIGHT_SLACK]
    if not low:
        return
    lowest = min(heights.values())
    remedy = (
        "heights are unknown; say where the ground is (ground)"
        if ground is None
        else f"the ground is said to be at {ground:g} m along up, in the calibration's world (ground): negative where "
        "it is below the origin"
    )
    note(
        f"warning: {', '.join(low)} {'is' if len(low) == 1 else 'are'} not above the ground (lowest at z = "
        f"{lowest:.2f} m): {remedy}"
    )


def read_up(text: str) -> Floats:
    """(3,) direction of an axis with its sign, or of three numbers; UsageError for anything else."""
    sign, axis = (-1.0, text[1:]) if text.startswith("-") else (1.0, text.removeprefix("+"))
    if axis in AXES:
        return sign * np.array(AXES[axis])
    try:
        found = np.array([float(v) for v in text.split(",")])
    except ValueError:
        found = np.zeros(0)
    if found.shape != (3,) or not np.isfinite(found).all() or not found.any():
        raise UsageError(f"up: {text!r}: want auto, an axis with its sign (for example -y), or X,Y,Z")
    return found


def _horizons(rotations: Floats) -> str:
    """What the cameras' horizons say of the vertical, in words."""
    found = vertical(rotations)
    off = np.degrees(np.arccos(np.clip(found.up[2], -1.0, 1.0)))
    text = ", ".join(f"{v:.2f}" for v in found.up)
    return f"by the cameras' horizons up is ({text}), {off:.0f} degrees from z"
