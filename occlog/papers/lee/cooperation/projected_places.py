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
    """A form of the parallel projection model (an equation of `refine`), and the number of passes."""

    form: str
    passes: int


PROJECTIONS = {
    "Eq. 5.39": Projection(PRINTED, 1),
    "Eq. 5.40": Projection(PARALLEL, 1),
    "Eq. 5.39, 3 passes": Projection(PRINTED, 3),
    "Eq. 5.39, 10 passes": Projection(PRINTED, 10),
}


def projected(reference: Floats, sights: TagSightings, way: Projection) -> tuple[Floats, Bools]:
    """Move reference positions (N, 2) by what cameras see; return positions (N, 2), and the mask (N,) of those moved.

    A reference that no camera moves in some pass counts as not moved. `way` is the form and number of passes.
    """
    xy, found = reference, np.ones(len(reference), dtype=np.bool_)
    covariance = np.tile(np.eye(2), (len(reference), 1, 1))
    for _ in range(way.passes):
        moved = refine(xy, covariance, sights, way.form)
        xy, found = moved.xy, found & moved.used.any(axis=1)
    return xy, found


def crossed(sights: TagSightings) -> tuple[Floats, Bools]:
    """Positions (N, 2) where the lines of sight of two cameras intersect, and the mask (N,) of those that do."""
    n = len(sights.bearing)
    origins = np.tile(sights.position, (n, 1))
    met = triangulate(origins, sights.bearing.ravel(), sights.sigma.ravel(), 2 * np.arange(n + 1))
    return met.xy, met.status == TRIANGULATED


def sights_of(cameras: tuple[Camera, ...], bearing: Floats, sigma: float) -> TagSightings:
    """Convert bearings (N, C) [rad] of C cameras to sightings with the standard deviation `sigma` [rad]."""
    position = np.array([c.ground for c in cameras])
    return TagSightings(position, np.array([c.yaw for c in cameras]), bearing, np.full(bearing.shape, sigma))


def relocated(request: CameraRequest, scene: Scene, way: Projection) -> CameraRequest:
    """Replace the triangulated position in the answer to a request by that of the parallel projection model.

    Two lines go through the position where they intersect, so that its bearings are theirs. The covariance stays
    that of the intersection. Without a position by the model the answer has none; requests without two cameras are
    unchanged.
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
