"""Positions by the parallel projection model of [Lee] Secs. 3.2.2 and 5.2.3, and those where lines of sight cross.

The model moves a reference point by what each of two cameras sees between it and the object, on the plane
through the point that is parallel to the camera's: Eqs. 5.39 and 5.40, where the thesis describes it.  When an
array asks, the reference is its own estimate.  [45], the source, is not among the texts; by its title it is
iterative: each position is the reference of the next pass.  Where Eq. 5.39 moves nothing more, lines of sight cross.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats
from occlog.core.geometry.triangulate import TRIANGULATED, triangulate
from occlog.records.scene import Camera, Scene
from occlog.track.methods.imm.camera_requests import CameraRequest
from occlog.track.methods.readers.refine import PARALLEL, PRINTED, TagSightings, refine

LINES = "lines of sight"


class Projection(NamedTuple):
    """A form of `refine`, and how often it is applied."""

    form: str
    passes: int


PROJECTIONS = {
    "Eq. 5.39": Projection(PRINTED, 1),
    "Eq. 5.40": Projection(PARALLEL, 1),
    "Eq. 5.39, 3 passes": Projection(PRINTED, 3),
    "Eq. 5.39, 10 passes": Projection(PRINTED, 10),
}


def projected(reference: Floats, sights: TagSightings, way: Projection) -> tuple[Floats, Bools]:
    """Move references (N, 2) by what cameras see, and return positions (N, 2), and the mask (N,) of those moved.

    A reference that no camera moves in some pass counts as not moved. `way`: form and number of passes.
    """
    xy, found = reference, np.ones(len(reference), dtype=np.bool_)
    covariance = np.tile(np.eye(2), (len(reference), 1, 1))
    for _ in range(way.passes):
        moved = refine(xy, covariance, sights, way.form)
        xy, found = moved.xy, found & moved.used.any(axis=1)
    return xy, found


def crossed(sights: TagSightings) -> tuple[Floats, Bools]:
    """Return the positions (N, 2) where the lines of sight of two cameras cross, and the mask (N,) of those that do."""
    n = len(sights.bearing)
    origins = np.tile(sights.position, (n, 1))
    met = triangulate(origins, sights.bearing.ravel(), sights.sigma.ravel(), 2 * np.arange(n + 1))
    return met.xy, met.status == TRIANGULATED


def sights_of(cameras: tuple[Camera, ...], bearing: Floats, sigma: float) -> TagSightings:
    """Return bearings (N, C) [rad] of C cameras as sightings with one standard deviation.

    `bearing`: (N, C); `sigma`: standard deviation [rad].
    """
    position = np.array([c.ground for c in cameras])
    return TagSightings(position, np.array([c.yaw for c in cameras]), bearing, np.full(bearing.shape, sigma))


def relocated(request: CameraRequest, scene: Scene, way: Projection) -> CameraRequest:
    """Return a request with an answer that has the position of the model instead of the triangulated one.

    Two lines go through the position where they cross, so that its bearings are theirs.  The covariance stays that
    of the crossing.  Where the model has no position, the request is in vain.
    """
    answer = request.answer
    if answer.position is None or len(request.cameras) != 2:
        return request
    cameras = tuple(scene.camera(name) for name in request.cameras)
    away = answer.position - np.array([c.ground for c in cameras])
    sights = sights_of(cameras, np.arctan2(away[:, 1], away[:, 0])[None], 1e-3)
    xy, found = projected(answer.ask.position[None], sights, way)
    if not found[0]:
        return request._replace(answer=answer._replace(position=None, covariance=None))
    return request._replace(answer=answer._replace(position=xy[0]))
