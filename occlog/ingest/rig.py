"""The line that states what was understood of a calibration: unit, handedness, centres, where the optical axes meet.

A wrong convention is seen at once in it.
"""

from __future__ import annotations

import numpy as np

from occlog.console.text import counted
from occlog.core.geometry.camera import looks_away, meeting_point
from occlog.io.formats.calibration.reader import CalibrationFile


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
