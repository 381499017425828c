"""Which way is up, from how cameras are turned.

People mount cameras so that the horizon is level in the image: the x axis of the image, to the right, is horizontal,
whatever the pitch.  The vertical is the direction that is nearest to perpendicular to the x axes of all cameras.
Cameras that all look the same way leave their pitch open; it is then taken for 0.  A camera that hangs upside down has
a horizontal x axis, too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats

APART = 0.03
"""x axes tell the vertical if the second smallest eigenvalue of their mean square is above this (10 degrees apart)."""
ROLLED = np.radians(30.0)
"""Cameras of an upright world are rolled less than this, in the median."""
LOOKS_UP = np.radians(45.0)
"""Cameras of an upright world look up by less than this, in the median."""
LEVEL = np.radians(10.0)
"""Horizons that are level to this agree on a vertical ..."""
TILTED = np.radians(15.0)
"""... and a world that is tilted more than this against it is not upright."""


class Vertical(NamedTuple):
    """The estimated direction up."""

    up: Floats  # (3,) unit vector in the world
    certain: bool  # the x axes differ enough; else pitches are taken for 0
    roll: float  # median roll of the cameras against it [rad]


def vertical(rotations: Floats) -> Vertical:
    """Up by (C, 3, 3) world-from-camera rotations, C >= 1."""
    x, up = rotations[:, :, 0], -rotations[:, :, 1]
    mean = up.mean(axis=0)
    values, vectors = np.linalg.eigh(x.T @ x / len(x))
    certain = bool(values[1] > APART)
    if certain:
        found = vectors[:, 0]
    else:  # perpendicular to the common x axis, in the middle of the image's vertical axes
        axis = vectors[:, 2]
        found = mean - (mean @ axis) * axis
        if np.linalg.norm(found) < 1e-6:
            found = vectors[:, 0]
    found = found / np.linalg.norm(found)
    if np.median(up @ found) < 0.0:
        found = -found
    return Vertical(np.asarray(found), certain, float(np.median(_roll(rotations, found))))


def seems_upright(rotations: Floats) -> bool:
    """Whether the z axis of the world can be the vertical of (C, 3, 3) world-from-camera rotations; true for C = 0.

    It cannot if most cameras are rolled by more than `ROLLED` or look up by more than `LOOKS_UP`; if most hang
    upside down and look up; or if the horizons of three or more agree, to `LEVEL`, on a vertical that is `TILTED` off.
    """
    if not len(rotations):
        return True
    z = np.array([0.0, 0.0, 1.0])
    pitch = np.median(np.arcsin(np.clip(rotations[:, 2, 2], -1.0, 1.0)))
    over = float(np.median(-rotations[:, 2, 1])) < 0.0
    roll = float(np.median(_roll(rotations, z)))
    if roll > ROLLED or pitch > LOOKS_UP or (over and pitch > 0.0):
        return False
    found = vertical(rotations)
    off = float(np.arccos(np.clip(abs(found.up[2]), 0.0, 1.0)))
    # Two horizons agree on a vertical in any case
    return not (len(rotations) > 2 and found.certain and found.roll < LEVEL and off > TILTED)


def turn_upright(up: Floats) -> Floats:
    """(3, 3) the smallest rotation that takes a direction up (3,) to the z axis; about x if it points straight down.

    ValueError for a direction without length.
    """
    length = float(np.linalg.norm(up))
    if not length > 0.0 or not np.isfinite(length):
        raise ValueError("up has no direction")
    x, y, z = np.asarray(up, dtype=np.float64) / length
    if z < -1.0 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    # Rodrigues' formula for the axis up x z
    cross = np.array([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]])
    return np.asarray(np.eye(3) + cross + cross @ cross / (1.0 + z))


def _roll(rotations: Floats, up: Floats) -> Floats:
    """(C,) angles of the image's x axis above or below the horizon [rad]."""
    return np.asarray(np.arcsin(np.clip(np.abs(rotations[:, :, 0] @ up), 0.0, 1.0)))
