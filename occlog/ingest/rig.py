"""What was understood of a calibration, as a line and as checks.

The line has unit, handedness, centres, and where the optical axes meet: a wrong convention is seen at once in it.  The
checks are of the world of the cameras: whether it is right-handed and upright, and the cameras are above the ground.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from occlog.console.text import counted
from occlog.core.geometry.camera import LEVEL, is_upright, looks_away, meeting_point, vertical
from occlog.io.formats.calibration.common import CALIBRATION
from occlog.io.formats.calibration.reader import CalibrationFile
from occlog.records.scene import HEIGHT_SLACK, Camera
from occlog.records.verdicts import Check, finding, outcome

HANDED, UPRIGHT, HEIGHTS = "handedness of the world", "vertical of the world", "camera heights"
"""Names of checks."""
AUTO = "auto"
"""Value of `up` that finds the vertical by the horizons of the cameras."""


def describe(calibration: CalibrationFile) -> str:
    """One line: format, unit, handedness, cameras with their centres in metres, and where their optical axes meet.

    A point that is not in front of all cameras is not stated.
    """
    cameras = calibration.cameras
    centres = ", ".join(f"{c.name} ({c.position[0]:.2f}, {c.position[1]:.2f}, {c.position[2]:.2f})" for c in cameras)
    unit = calibration.unit if calibration.unit == "m" else f"{calibration.unit} -> m"
    count = counted(len(cameras), "camera")
    positions, rotations = np.array([c.position for c in cameras]), np.array([c.rotation for c in cameras])
    handed = "" if looks_away(positions, rotations) else "right-handed, "
    if calibration.mirror is not None:
        handed = f"left-handed ({calibration.mirror} is mirrored), "
    text = f"calibration: {calibration.format}, {unit}, {handed}{count} at {centres}"
    if len(cameras) < 2:
        return text
    # Cameras of a left-handed world have behind them what they see, until it is mirrored
    axes = rotations[:, :, 2] * (1.0 if calibration.mirror is None else -1.0)
    point, along = meeting_point(positions, axes)
    behind = [c.name for c, distance in zip(cameras, along.tolist(), strict=True) if not distance > 0.0]
    if behind:
        those = "any camera" if len(behind) == len(cameras) else ", ".join(behind)
        return f"{text}; optical axes do not meet in front of {those}"
    off = np.linalg.norm(point - positions - along[:, None] * axes, axis=1)
    return text + (
        f"; optical axes meet near ({point[0]:.2f}, {point[1]:.2f}, {point[2]:.2f}) and pass it at "
        f"{off.mean():.2f} m on average"
    )


def world_checks(cameras: Sequence[Camera], up: str | None, *, ground_stated: bool) -> tuple[Check, ...]:
    """Checks of the world of calibrated cameras; without cameras, none can be made.

    Args:
        cameras: as they are in the scene, after the world was mirrored and turned.
        up: as the user gave it; None: the world of the calibration stays.
        ground_stated: the user stated the height of the ground.
    """
    placed = [c for c in cameras if c.placed]
    if not placed:
        names = (CALIBRATION, HANDED, UPRIGHT, HEIGHTS)
        return tuple(check for name in names for check in outcome(name, (), unless="there is no calibration"))
    rotations = np.array([c.rotation for c in placed])
    away = looks_away(np.array([c.position for c in placed]), rotations)
    if up is None and (away or not is_upright(rotations)) and _upright_if_inverted(placed):
        inverted = "the extrinsics seem to be inverted"
        return (
            *outcome(HANDED, (), unless=inverted),
            *outcome(UPRIGHT, [finding(UPRIGHT, "extrinsics-inverted", sensors=[c.name for c in placed])]),
            *outcome(HEIGHTS, (), unless=inverted),
        )
    if away:
        left = "the world seems to be left-handed"
        return (
            *outcome(HANDED, [finding(HANDED, "world-left-handed")]),
            *outcome(UPRIGHT, (), unless=left),
            *outcome(HEIGHTS, (), unless=left),
        )
    tilted = [*tilted_world(rotations, up)]
    unknown = up is None and bool(tilted) and not ground_stated
    return (
        *outcome(HANDED, ()),
        *outcome(UPRIGHT, tilted),
        *outcome(HEIGHTS, () if unknown else _low(placed), unless="the vertical is unknown" if unknown else ""),
    )


def tilted_world(rotations: np.ndarray, up: str | None = None) -> Iterator[Check]:
    """Find a world that is not upright, or turned upright by horizons that leave the pitch of the cameras open."""
    if up is None and not is_upright(rotations):
        direction = vertical(rotations).up
        off_deg = float(np.degrees(np.arccos(np.clip(direction[2], -1.0, 1.0))))
        text = ", ".join(f"{v:.2f}" for v in direction)
        yield finding(UPRIGHT, "world-not-upright", up=text, off_deg=off_deg)
    elif up == AUTO and not vertical(rotations).certain:
        yield finding(UPRIGHT, "vertical-uncertain")


def _upright_if_inverted(cameras: Sequence[Camera]) -> bool:
    """Whether two or more cameras would be level, look down from above the ground, and at a common point.

    With R and T the other way round: `rotation` is then its transpose, and the position minus that times the position.
    """
    if len(cameras) < 2:
        return False
    rotations = np.array([c.rotation.T for c in cameras])
    positions = np.array([-c.rotation.T @ c.position for c in cameras])
    level = np.abs(rotations[:, 2, 0]) < np.sin(LEVEL)
    down = (rotations[:, 2, 2] < 0.0) & (rotations[:, 2, 1] < 0.0)
    _, along = meeting_point(positions, rotations[:, :, 2])
    return bool((level & down & (positions[:, 2] > HEIGHT_SLACK) & (along > 0.0)).all())


def _low(cameras: Sequence[Camera]) -> Iterator[Check]:
    """Find cameras that are not above the ground."""
    heights = {c.name: float(c.position[2]) for c in cameras}
    low = [name for name, height in heights.items() if height <= HEIGHT_SLACK]
    if low:
        yield finding(HEIGHTS, "camera-not-above-ground", sensors=low, lowest=min(heights.values()), unit="m")
