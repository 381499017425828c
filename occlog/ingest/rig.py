"""Description and checks of the world frame of calibrated cameras.

The description has unit, handedness, camera centres, and the point where the optical axes meet, which reveals a wrong
convention at once. The checks are whether the world is right-handed and upright, and the cameras are above the ground.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from occlog.array_types import Floats
from occlog.console.text import counted
from occlog.core.geometry.camera import intersection_point, is_upright, looks_away, other_up_axis, vertical
from occlog.io.formats.calibration.common import CALIBRATION
from occlog.io.formats.calibration.reader import CalibrationFile
from occlog.records.scene import HEIGHT_SLACK, Camera, other_angle_readings
from occlog.records.verdicts import Check, finding, outcome

HANDED, UPRIGHT, HEIGHTS, ANGLES = "handedness of the world", "vertical of the world", "camera heights", "scene angles"
POSES = "camera poses"
"""Names of checks."""
AUTO = "auto"
"""Value of `up` that finds the vertical by the horizons of the cameras."""


def describe(calibration: CalibrationFile) -> str:
    """One line on a calibration: format, unit, handedness, camera centres [m], and where the optical axes meet.

    The text states if that point is not in front of all cameras; it is omitted for a single camera.
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
    point, along = intersection_point(positions, axes)
    behind = [c.name for c, distance in zip(cameras, along.tolist(), strict=True) if not distance > 0.0]
    if behind:
        those = "any camera" if len(behind) == len(cameras) else ", ".join(behind)
        return f"{text}; optical axes do not meet in front of {those}"
    off = np.linalg.norm(point - positions - along[:, None] * axes, axis=1)
    return text + (
        f"; optical axes meet near ({point[0]:.2f}, {point[1]:.2f}, {point[2]:.2f}) and pass it at "
        f"{off.mean():.2f} m on average"
    )


def world_checks(
    cameras: Sequence[Camera],
    up: str | None,
    *,
    ground_stated: bool,
    mirror: str | None = None,
    turned_by: Floats | None = None,
) -> tuple[Check, ...]:
    """Outcomes of checks of the world of calibrated cameras: right-handed, upright, cameras above the ground.

    Without cameras with poses each of them states that it could not be made. Also examined is whether other conventions
    of the extrinsics fit better (inverted, transposed, other axes).

    Args:
        cameras: as they are in the scene, after the world was mirrored and turned.
        up: as the user gave it; None: the world of the calibration stays.
        ground_stated: the user stated the height of the ground.
        mirror: axis that was negated; None: none.
        turned_by: (3, 3) by which the world was mirrored and turned; None: it was not.
    """
    placed = [c for c in cameras if c.placed]
    if not placed:
        names = (CALIBRATION, HANDED, UPRIGHT, HEIGHTS)
        return tuple(check for name in names for check in outcome(name, (), unless="there is no calibration"))
    rotations, centres = np.array([c.rotation for c in placed]), np.array([c.position for c in placed])
    as_read = up is None and not ground_stated
    if looks_away(centres, rotations):
        if misread := [*_misread(placed)] if as_read else []:
            return (*outcome(HANDED, ()), *outcome(UPRIGHT, misread), *outcome(HEIGHTS, (), unless="they are misread"))
        left = "the world seems to be left-handed"
        return (
            *outcome(HANDED, [finding(HANDED, "world-left-handed" if mirror is None else "world-mirrored")]),
            *outcome(UPRIGHT, (), unless=left),
            *outcome(HEIGHTS, (), unless=left),
        )
    tilted = [*tilted_world(rotations, up, mirror, turned_by)]
    unknown = up is None and bool(tilted) and not ground_stated
    low = [] if unknown else [*_low(placed)]
    off = _distance_from_axes(centres, rotations[:, :, 2]) if len(placed) > 2 else 0.0
    # Cameras that agree on another axis are read as meant
    agreed = bool(tilted) and other_up_axis(rotations) is not None
    if agreed and up is not None:
        low = []
    limit = NEAR if (tilted or low) and not agreed else min(NEAR, off / NEARER) if off > NEAR else 0.0
    misread = [*_misread(placed, limit)] if as_read and limit else []
    single = [*_misread_ones(placed)] if as_read and not misread and not agreed else []
    buried = [] if single else low
    return (
        *outcome(HANDED, ()),
        *outcome(UPRIGHT, misread or single or tilted),
        *outcome(HEIGHTS, buried, unless="the vertical is unknown" if unknown and not single else ""),
    )


def tilted_world(
    rotations: Floats, up: str | None = None, mirror: str | None = None, turned_by: Floats | None = None
) -> Iterator[Check]:
    """Yield a finding if the world of cameras is not upright, or if `auto` cannot determine the vertical.

    The vertical is estimated from the cameras' horizons, which leave it open if all cameras have about the same
    direction. A vertical that the user gave is contradicted only by cameras that agree on another axis. The finding
    names the vertical in the calibration's own world, as `up` states it, and repeats the mirrored axis.

    Args:
        rotations: (C, 3, 3) world-from-camera rotations, after the world was mirrored and turned.
        up: as the user gives it: None, `auto`, or a direction.
        mirror: axis that was negated; None: none.
        turned_by: (3, 3) by which the world was mirrored and turned; None: it was not.
    """
    axis = other_up_axis(rotations)
    if up == AUTO:
        if not vertical(rotations).certain:
            yield finding(UPRIGHT, "vertical-uncertain")
    elif axis is not None or (up is None and not is_upright(rotations)):
        direction = vertical(rotations).up if axis is None else axis_vector(axis)
        off_deg = float(np.degrees(np.arccos(np.clip(direction[2], -1.0, 1.0))))
        own = direction if turned_by is None else direction @ turned_by
        name = next((a for a in ("x", "y", "z", "-x", "-y", "-z") if axis_vector(a) @ own > ON_AXIS), None)
        text = name or f"({', '.join(f'{v:.2f}' for v in own)})"
        turn = (name if axis is not None else None) or "auto, or X,Y,Z"
        also = "" if mirror is None else f"--mirror {mirror} "
        yield finding(UPRIGHT, "world-not-upright", up=text, off_deg=off_deg, of=up or "z", turn=turn, mirror=also)


ON_AXIS = 1.0 - 1e-9
"""Cosine of the angle to an axis, above which a direction is that axis."""


def axis_vector(name: str) -> Floats:
    """Return the unit vector (3,) of a signed axis, as `-y`."""
    return np.where([a == name[-1] for a in "xyz"], -1.0 if name.startswith("-") else 1.0, 0.0)


OPENGL = np.diag([1.0, -1.0, -1.0])
"""Camera axes of OpenGL (x right, y up, z backward) by those of a scene, and back."""
BODY = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Camera axes of a scene by those of a body (x forward, y left, z up)."""


NEAR, NEARER = 0.15, 3.0
"""Axes meet if their mean distance from one place is below this share of the distance between the cameras; and by how
much less it has to be with another meaning of the extrinsics, where nothing else contradicts them."""
MAX_VIEW = 4.0
"""Longest distance from cameras to the place that all of them view, over the extent of their positions: axes that are
nearly parallel meet far away."""


def _distance_from_axes(places: Floats, axes: Floats) -> float:
    """Mean distance of the optical axes from the point nearest to all, divided by the extent of the cameras' positions.

    Infinite if that point is not in front of all cameras, or the extent is 0.

    Args:
        places: (n, 3) camera centres in the world.
        axes: (n, 3) unit vectors along the optical axes.
    """
    point, along = intersection_point(places, axes)
    extent = float(np.linalg.norm(np.ptp(places, axis=0)))
    if not (along > 0.0).all() or extent == 0.0:
        return np.inf
    return float(np.linalg.norm(point - places - along[:, None] * axes, axis=1).mean()) / extent


def _misread(cameras: Sequence[Camera], limit: float = NEAR) -> Iterator[Check]:
    """Yield a finding if all cameras become upright, above ground and directed at one point by another convention.

    Such conventions of the extrinsics are inverted or transposed poses and other axes; the best of them is reported.

    Args:
        cameras: as read.
        limit: mean distance of the optical axes from that point, over the extent of the cameras, below which it fits.
    """
    found = [
        (_distance_from_axes(places, axes[:, :, 2]), change)
        for change, axes, places in _meanings(cameras)
        if (places[:, 2] > HEIGHT_SLACK).all() and is_upright(axes)
    ]
    if found and min(found)[0] < limit:
        yield finding(UPRIGHT, "extrinsics-fit-if", change=min(found)[1])


def _misread_ones(cameras: Sequence[Camera]) -> Iterator[Check]:
    """Yield a finding for each single camera that fits the others by another convention of its extrinsics.

    It then is upright, above the ground, and directed at the point that the others view. Examined are cameras that are
    not above the ground or, if there are none, those that are not upright; none if they are more than half of all.
    """
    odd = [c for c, camera in enumerate(cameras) if camera.position[2] <= HEIGHT_SLACK]
    odd = odd or [c for c, camera in enumerate(cameras) if not is_upright(camera.rotation[None])]
    if 2 * len(odd) > len(cameras):
        return
    others = [camera for c, camera in enumerate(cameras) if c not in odd]
    for c in odd:
        found: list[tuple[float, str]] = []
        for change, axes, places in _meanings([cameras[c]]):
            if places[0, 2] > HEIGHT_SLACK and is_upright(axes):
                all_places = np.concatenate([places, [camera.position for camera in others]])
                all_axes = np.concatenate([axes, [camera.rotation for camera in others]])[:, :, 2]
                found.append((_distance_from_axes(all_places, all_axes), change))
        least = min(found, default=(np.inf, ""))[0]
        if least < NEAR:
            # The most usual meaning of those that fit about as well
            change = next(change for distance, change in found if distance < min(NEAR, NEARER * least))
            yield finding(UPRIGHT, "camera-extrinsics-fit-if", sensors=[cameras[c].name], change=change)


def _meanings(cameras: Sequence[Camera]) -> Iterator[tuple[str, Floats, Floats]]:
    """Yield the extrinsics of n cameras as they would be if the file had another convention.

    Yields:
        Description of the convention, (n, 3, 3) world-from-camera rotations, (n, 3) camera centres.
    """
    from scipy.spatial.transform import Rotation

    rotations, centres = np.array([c.rotation for c in cameras]), np.array([c.position for c in cameras])
    inverse = rotations.transpose(0, 2, 1)  # camera-from-world
    shifts = -np.einsum("nij,nj->ni", inverse, centres)
    # Orders of quaternions: ROS has w last in world-from-camera, COLMAP w first in camera-from-world rotations
    w_last = Rotation.from_quat(np.roll(Rotation.from_matrix(rotations).as_quat(), -1, axis=1)).as_matrix()
    w_first = Rotation.from_quat(np.roll(Rotation.from_matrix(inverse).as_quat(), 1, axis=1)).inv().as_matrix()
    yield "camera-to-world (inverted)", inverse, shifts
    yield "camera-to-world in OpenGL's axes (y up, z backward)", inverse @ OPENGL, shifts
    yield "read with transposed rotations", inverse, -np.einsum("nij,nj->ni", inverse, shifts)
    yield "read with centres for translations", rotations, shifts
    yield "those of bodies (x forward, y left, z up)", rotations @ BODY, centres
    yield "quaternions with w first, read as x, y, z, w", w_last, centres
    yield "quaternions with w last, read as w, x, y, z", w_first, -np.einsum("nij,nj->ni", w_first, shifts)


def scene_checks(cameras: Sequence[Camera]) -> tuple[Check, ...]:
    """Outcome of the check whether angles of cameras in a scene file are in another unit or sense.

    They are if all cameras then view one place, which is below them, and as stated they do not.
    """
    placed = [c for c in cameras if c.has_height]
    if len(placed) < 2:
        return outcome(ANGLES, (), unless="the scene has fewer than two cameras with poses in space")
    centres = np.array([c.position for c in placed])

    def off(rotations: Floats) -> float:
        point, along = intersection_point(centres, rotations[:, :, 2])
        near = float(along.max()) < MAX_VIEW * float(np.linalg.norm(np.ptp(centres, axis=0)))
        below = point[2] < centres[:, 2].min()
        return _distance_from_axes(centres, rotations[:, :, 2]) if near and below else np.inf

    given = off(np.array([c.rotation for c in placed]))
    by_camera = [dict(other_angle_readings(c.rotation)) for c in placed]
    changes = [words for words in by_camera[0] if all(words in each for each in by_camera)]
    found = {words: off(np.array([each[words] for each in by_camera])) for words in changes}
    change = min(found, key=found.__getitem__)
    fits = found[change] < NEAR and NEARER * found[change] < given
    return outcome(ANGLES, [finding(ANGLES, "scene-angles-fit-if", change=change)] if fits else ())


def pose_checks(cameras: Sequence[Camera]) -> tuple[Check, ...]:
    """Outcome of the check whether cameras have exactly the same pose, as if extrinsics had been copied."""
    placed = [c for c in cameras if c.has_height]
    same = dict.fromkeys(
        name
        for a, b in combinations(placed, 2)
        if np.array_equal(a.position, b.position) and np.array_equal(a.rotation, b.rotation)
        for name in (a.name, b.name)
    )
    found = [finding(POSES, "cameras-same-pose", sensors=same)] if same else []
    return outcome(POSES, found, unless="" if len(placed) > 1 else "fewer than two cameras have poses in space")


def _low(cameras: Sequence[Camera]) -> Iterator[Check]:
    """Yield a finding with the cameras that are at or below the ground z = 0, if there are any."""
    heights = {c.name: float(c.position[2]) for c in cameras}
    low = [name for name, height in heights.items() if height <= HEIGHT_SLACK]
    if low:
        yield finding(HEIGHTS, "camera-not-above-ground", sensors=low, lowest=min(heights.values()), unit="m")
