"""Expected box of a person: projection of an upright ellipsoid on the floor by a camera with lens distortion.

A person of height h and width w at (x, y) is the ellipsoid with the centre m = (x, y, h / 2) and the half axes
w / 2, w / 2, h / 2.  In the camera's frame, p = R' (m - c) is its centre and A = R' diag(w^2, w^2, h^2) R / 4 its
shape; its outline in the normalised image is the conic with the dual C = A - p p' (Hartley and Zisserman 2004,
Eq. 8.6, up to sign).  A line l touches the outline where l' C l = 0, at the point C l: the vertical and horizontal
tangents are the box of an ideal lens.  A lens with distortion moves the four points of contact; the box is around
them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.geometry.lens import fold_radius, to_usable, undistort
from occlog.core.geometry.lens import tilt as sensor_tilt
from occlog.core.numerics.jit import kernel
from occlog.records.scene import Camera

from ..interface import PositionSource

LEFT, TOP, RIGHT, BOTTOM = range(4)
UNOBSERVED_SIZE_PX = 1e9
"""Width and height [px] of an image of unspecified size: no border cuts its boxes."""
LENS_LIMIT_RATIO = 1.2
"""Radius of validity of the lens model, in distances of the farthest corner from the optical axis; farther out its
polynomial may turn back, so that it is continued by a straight line."""
DIFFERENCE_STEP_HEIGHTS = 1e-4
"""Step of the difference quotients, in heights of the person."""
MIN_DEPTH_HEIGHTS = 0.05
"""Minimum depth of a person's nearest point, in heights."""
LENS = 38
"""Numbers of a row of `PackedCameras.lens`."""
STRAIGHT, BENT, BENT_BACK, FISHEYE, POSITION_SOURCE, COMPLETE = 0.0, 1.0, 2.0, 3.0, 4.0, 5.0
"""Lenses: no distortion; ideal points to distorted ones by a polynomial; distorted points to ideal ones by it; by a
polynomial of the angle to the optical axis.  `POSITION_SOURCE` is none: positions on the ground plane, from above.
A "box" there is (x, y, x, y) in the scene's unit, of which the first two edges are used, and the row of the lens begins
with the limits of the area that the source covers: least x, least y, greatest x, greatest y.  `COMPLETE` is OpenCV's
complete model."""
MODEL = 21
"""Index of the model in a row of `PackedCameras.lens`."""
COVERAGE_MARGIN_M = 1.0
"""Margin about the positions that a source has reported within which it is taken to cover the ground [m]."""
MODELS = {"brown": BENT, "opencv": COMPLETE, "tsai": BENT_BACK, "equidistant": FISHEYE}
"""Lens of each model of distortion."""


class PackedCameras(NamedTuple):
    """C cameras and position sensors, and W static occluders, packed into arrays for the kernels.

    World `position` (C, 3), `rotation` (C, 3, 3) world-from-camera, `focal` and `principal` (C, 2) [px], image `size`
    (C, 2) [px], `range` (C,), the farthest distance at which a person is seen, and `lens` (C, LENS), all of these and
    the distortion in a row. Occluder w is the polygon `corner[first[w]:first[w + 1]]` on the floor with the height
    `top[w]`.
    """

    position: Floats  # (C, 3)
    rotation: Floats  # (C, 3, 3) world-from-camera
    focal: Floats  # (C, 2) [px]
    principal: Floats  # (C, 2) [px]
    lens: Floats  # (C, LENS) intrinsics, extrinsics and distortion, in a row; see `_lens`
    size: Floats  # (C, 2) width, height [px]
    range: Floats  # (C,) farthest distance at which a person is seen
    corner: Floats  # (V, 2) of static occluders
    first: Ints  # (W + 1,) occluder w has the corners first[w] to first[w + 1] - 1
    top: Floats  # (W,) height; may be infinite


def pack_views(
    views: Sequence[Camera | PositionSource], occluders: Sequence[tuple[Floats, float]] = ()
) -> PackedCameras:
    """Pack cameras with known poses, position sensors, and static occluders into arrays.

    Args:
        views: cameras, then sources of positions; ValueError in another order.
        occluders: polygon (K, 2) and height (may be infinite) of each.
    """
    cameras = [each for each in views if not isinstance(each, PositionSource)]
    packed = _pack_cameras(cameras, occluders)
    n = len(views) - len(cameras)
    if not n:
        return packed
    if any(isinstance(each, PositionSource) for each in views[: len(cameras)]):
        raise ValueError("views: sources of positions must come after all cameras")
    lens = np.zeros((n, LENS))
    lens[:, :4] = [math.inf, math.inf, -math.inf, -math.inf]
    lens[:, MODEL] = POSITION_SOURCE
    return packed._replace(
        position=np.concatenate([packed.position, np.zeros((n, 3))]),
        rotation=np.concatenate([packed.rotation, np.tile(np.eye(3), (n, 1, 1))]),
        focal=np.concatenate([packed.focal, np.ones((n, 2))]),
        principal=np.concatenate([packed.principal, np.zeros((n, 2))]),
        lens=np.concatenate([packed.lens, lens]),
        size=np.concatenate([packed.size, np.ones((n, 2))]),
        range=np.concatenate([packed.range, np.full(n, math.inf)]),
    )


def cover_positions(views: PackedCameras, c: int, positions: Floats, metre: float) -> PackedCameras:
    """Return the cameras, with the coverage of position sensor `c` extended to `positions` (n, 2) and a margin.

    The margin is `COVERAGE_MARGIN_M`; `metre` is the length of a metre in the scene's unit. The argument is not
    changed.
    """
    if not len(positions):
        return views
    lens, size = views.lens.copy(), views.size.copy()
    margin = COVERAGE_MARGIN_M * metre
    lens[c, :2] = np.minimum(lens[c, :2], positions.min(axis=0) - margin)
    lens[c, 2:4] = np.maximum(lens[c, 2:4], positions.max(axis=0) + margin)
    size[c] = lens[c, 2:4] - lens[c, :2]
    return views._replace(lens=lens, size=size)


def _pack_cameras(cameras: Sequence[Camera], occluders: Sequence[tuple[Floats, float]]) -> PackedCameras:
    """Pack cameras, and static occluders given as (polygon (K, 2), height), into arrays.

    A camera without an image size gets a size that cuts no box.
    """
    size = [c.image_size if c.image_size is not None else (UNOBSERVED_SIZE_PX, UNOBSERVED_SIZE_PX) for c in cameras]
    return PackedCameras(
        position=np.array([c.position for c in cameras], dtype=np.float64).reshape(-1, 3),
        rotation=np.array([c.rotation for c in cameras], dtype=np.float64).reshape(-1, 3, 3),
        focal=np.array([c.focal_px for c in cameras], dtype=np.float64).reshape(-1, 2),
        principal=np.array([c.principal_px for c in cameras], dtype=np.float64).reshape(-1, 2),
        lens=np.array([_lens(c) for c in cameras], dtype=np.float64).reshape(-1, LENS),
        size=np.array(size, dtype=np.float64).reshape(-1, 2),
        range=np.array([c.range for c in cameras], dtype=np.float64),
        corner=np.concatenate([np.zeros((0, 2)), *(np.asarray(p, dtype=np.float64) for p, _ in occluders)]),
        first=np.concatenate([[0], np.cumsum([len(p) for p, _ in occluders])]).astype(np.int64),
        top=np.array([top for _, top in occluders], dtype=np.float64),
    )


def _lens(camera: Camera) -> Floats:
    """Return a row (LENS,) of `PackedCameras.lens`: extrinsics, intrinsics and distortion of a camera.

    Position (3,), rotation world-from-camera by rows (9,), focal lengths (2,), principal point (2,), the first five
    coefficients of the distortion, the lens model (`STRAIGHT` to `COMPLETE`), the normalised radius to which it is
    valid; then k4, k5, k6, s1 to s4 and the first eight numbers of the tilt's homography by rows, over the ninth, of
    OpenCV's complete model (0 for others).
    """
    model = STRAIGHT if camera.straight else MODELS[camera.distortion_model]
    parts = (camera.position, camera.rotation, camera.focal_px, camera.principal_px, camera.distortion[:5])
    rest = np.zeros(LENS - MODEL - 2)
    if model == COMPLETE:
        plane = sensor_tilt(*camera.distortion[12:14].tolist())
        rest = np.concatenate([camera.distortion[5:12], (plane / plane[2, 2]).ravel()[:8]])
    return np.concatenate([*(np.ravel(part) for part in parts), [model, _limit(camera)], rest])


def _limit(camera: Camera) -> float:
    """Return the radius in the undistorted normalised image up to which the camera's lens model is valid.

    It is infinite without distortion or image size.
    """
    if camera.image_size is None or camera.straight:
        return math.inf
    w, h = camera.image_size
    corners = np.array([[u, v] for u in (-0.5, w - 0.5) for v in (-0.5, h - 0.5)])
    bent, model = (corners - camera.principal_px) / camera.focal_px, camera.distortion_model
    usable = to_usable(bent, camera.distortion, model)
    ideal = undistort(usable, camera.distortion, model)
    radius = float(np.hypot(ideal[:, 0], ideal[:, 1]).max())
    if (usable != bent).any():  # the lens is not used beyond
        return radius
    far = LENS_LIMIT_RATIO * radius
    return min(far, fold_radius(camera.distortion, model, far))


@kernel
def distorted(lens: Floats, x: float, y: float) -> tuple[float, float]:
    """Return the distorted normalised image point of an ideal one (x, y).

    `lens` (LENS,) is a row of `PackedCameras.lens`, not with the model `STRAIGHT`. Beyond the radius of validity the
    mapping is continued by a straight line.
    """
    k1, k2, p1, p2, k3 = lens[16], lens[17], lens[18], lens[19], lens[20]
    radius = math.sqrt(x * x + y * y)
    # Beyond the valid radius: as at that radius, and further out in a straight line
    share = min(1.0, lens[22] / radius) if radius > 0.0 else 1.0
    out_x, out_y = x * (1.0 - share), y * (1.0 - share)
    x, y = x * share, y * share
    if lens[21] == BENT_BACK:
        ideal_x, ideal_y = x, y
        for _ in range(50):
            r2 = x * x + y * y
            x, y = ideal_x / (1.0 + k1 * r2), ideal_y / (1.0 + k1 * r2)
    elif lens[21] == FISHEYE:
        # Here k1, k2, k3, k4 of the lens are the first four numbers
        theta = math.atan(radius * share)
        t2 = theta * theta
        bent = theta * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (p1 + t2 * p2))))
        shrunk = bent / (radius * share) if radius > 0.0 else 1.0
        x, y = x * shrunk, y * shrunk
    else:
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        if lens[21] == COMPLETE:
            radial /= 1.0 + r2 * (lens[23] + r2 * (lens[24] + r2 * lens[25]))
        x, y = (
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        )
        if lens[21] == COMPLETE:
            x, y = x + r2 * (lens[26] + r2 * lens[27]), y + r2 * (lens[28] + r2 * lens[29])
            scale = lens[36] * x + lens[37] * y + 1.0
            x, y = (
                (lens[30] * x + lens[31] * y + lens[32]) / scale,
                (lens[33] * x + lens[34] * y + lens[35]) / scale,
            )
    return x + out_x, y + out_y


@kernel
def expected_box(lens: Floats, x: float, y: float, height: float, width: float, box: Floats) -> float:
    """Write the expected box of a person in a camera's image; return the depth of the body's centre.

    Args:
        lens: (LENS,) row of the camera in `PackedCameras.lens`.
        x: first coordinate of the person on the floor.
        y: second coordinate of the person on the floor.
        height: height of the person, > 0.
        width: width of the person, > 0.
        box: (4,) left, top, right, bottom [px], written; it may lie outside the image. (x, y, x, y) of a position
            sensor.

    Returns:
        Depth along the optical axis, > 0, and 1 for a position sensor; -1, and no box, where part of the person is
        behind the camera or closer than `MIN_DEPTH_HEIGHTS` heights, or so far away that rounding leaves no outline.
    """
    if lens[MODEL] == POSITION_SOURCE:
        box[0], box[1], box[2], box[3] = x, y, x, y
        return 1.0
    dx, dy, dz = x - lens[0], y - lens[1], 0.5 * height - lens[2]
    a2, b2 = 0.25 * width * width, 0.25 * height * height
    # Centre and shape in the camera's frame: p = R' (m - c), A = R' diag(a^2, a^2, b^2) R
    px = lens[3] * dx + lens[6] * dy + lens[9] * dz
    py = lens[4] * dx + lens[7] * dy + lens[10] * dz
    pz = lens[5] * dx + lens[8] * dy + lens[11] * dz
    lean = b2 - a2  # A = a^2 I + (b^2 - a^2) r r', r the last row of R
    rx, ry, rz = lens[9], lens[10], lens[11]
    azz = a2 + lean * rz * rz
    if pz - math.sqrt(azz) < MIN_DEPTH_HEIGHTS * height:
        return -1.0
    # Dual conic C = A - p p'
    cxx, cyy, czz = a2 + lean * rx * rx - px * px, a2 + lean * ry * ry - py * py, azz - pz * pz
    cxy, cxz, cyz = lean * rx * ry - px * py, lean * rx * rz - px * pz, lean * ry * rz - py * pz
    # Tangents x = u: C_xx - 2 u C_xz + u^2 C_zz = 0, C_zz < 0; and y = v likewise
    root_x, root_y = math.sqrt(max(cxz * cxz - cxx * czz, 0.0)), math.sqrt(max(cyz * cyz - cyy * czz, 0.0))
    if not (root_x > 0.0 and root_y > 0.0):
        return -1.0  # so far away that rounding leaves no outline
    for k in range(4):
        sign = -1.0 if k < 2 else 1.0
        if k in (LEFT, RIGHT):
            u = (cxz - sign * root_x) / czz
            # Point of contact C l, l = (1, 0, -u)
            at = (cxy - u * cyz) / (cxz - u * czz)
            box[k] = (u if lens[21] == STRAIGHT else distorted(lens, u, at)[0]) * lens[12] + lens[14]
        else:
            v = (cyz - sign * root_y) / czz
            at = (cxy - v * cxz) / (cyz - v * czz)
            box[k] = (v if lens[21] == STRAIGHT else distorted(lens, at, v)[1]) * lens[13] + lens[15]
    return float(pz)


@kernel
def box_and_slope(lens: Floats, state: Floats, delay: float, box: Floats, slope: Floats) -> float:
    """Write the expected box of a state in a camera's image and its Jacobian; return the depth along the optical axis.

    The depth is -1, and what is written undefined, where part of the person is behind or too close to the camera.

    Args:
        lens: (LENS,) row of the camera in `PackedCameras.lens`.
        state: (6,) x, y, vx, vy, height, width at the time step's time.
        delay: how much later than the time step the camera's frame is [s]; negative: earlier.
        box: (4,) written: left, top, right, bottom [px].
        slope: (4, 6) written: derivatives of the box by the state, by central differences.
    """
    x, y = state[0] + delay * state[2], state[1] + delay * state[3]
    height, width = state[4], state[5]
    depth = expected_box(lens, x, y, height, width, box)
    if depth < 0.0:
        return depth
    if lens[MODEL] == POSITION_SOURCE:
        slope[:] = 0.0
        for e in range(4):
            slope[e, e % 2], slope[e, 2 + e % 2] = 1.0, delay
        return depth
    step = DIFFERENCE_STEP_HEIGHTS * height
    high, low = np.empty(4), np.empty(4)
    for k in range(4):
        ex, ey = (step if k == 0 else 0.0), (step if k == 1 else 0.0)
        eh, ew = (step if k == 2 else 0.0), (step if k == 3 else 0.0)
        d_high = expected_box(lens, x + ex, y + ey, height + eh, width + ew, high)
        d_low = expected_box(lens, x - ex, y - ey, height - eh, width - ew, low)
        if d_high < 0.0 or d_low < 0.0:
            return -1.0
        to = k if k < 2 else k + 2
        for e in range(4):
            slope[e, to] = (high[e] - low[e]) / (2.0 * step)
    for e in range(4):
        slope[e, 2], slope[e, 3] = delay * slope[e, 0], delay * slope[e, 1]
    return depth


@kernel
def project(views: PackedCameras, c: int, mean: Floats, covariance: Floats, delay: float, out: Floats) -> None:
    """Project n people into camera c: expected boxes with the covariances of their centres.

    Args:
        views: cameras and position sensors.
        c: index of the camera.
        mean: (n, 6) states x, y, vx, vy, height, width.
        covariance: (n, 6, 6) covariances of the states.
        delay: how much later than the states the frame is [s].
        out: (n, 8) written: left, top, right, bottom [px], xx, xy and yy of the centre's covariance [px^2], and the
            depth; -1 where the person is behind the camera, and nothing else is written.
    """
    box, slope, centre = np.empty(4), np.empty((4, 6)), np.empty((2, 6))
    for k in range(mean.shape[0]):
        depth = box_and_slope(views.lens[c], mean[k], delay, box, slope)
        out[k, 7] = depth
        if depth < 0.0:
            continue
        out[k, :4] = box
        for i in range(6):
            centre[0, i] = 0.5 * (slope[LEFT, i] + slope[RIGHT, i])
            centre[1, i] = 0.5 * (slope[TOP, i] + slope[BOTTOM, i])
        for e in range(3):
            a, b = e // 2, (e + 1) // 2
            total = 0.0
            for i in range(6):
                for j in range(6):
                    total += centre[a, i] * covariance[k, i, j] * centre[b, j]
            out[k, 4 + e] = total
