"""Longitude and latitude (WGS 84) of places on the plane that touches the earth at an origin, and back."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats

A, F = 6_378_137.0, 1 / 298.257223563
"""Half axis [m] and flattening of the ellipsoid of WGS 84."""
E2 = F * (2.0 - F)
FARTHEST = 85.0
"""Latitude [deg] beyond which an origin is refused."""


class Origin(NamedTuple):
    """Where on earth the origin of a scene is, and how it is turned."""

    latitude: float  # [deg]
    longitude: float  # [deg]
    turned: float = 0.0  # angle of +x from the east towards the north [deg]


def degrees_of(xy: Floats, origin: Origin) -> Floats:
    """(N, 2) longitude and latitude [deg] of places (N, 2) [m] on the plane that touches the ellipsoid at an origin."""
    turned, latitude, longitude = np.radians([origin.turned, origin.latitude, origin.longitude]).tolist()
    east = math.cos(turned) * xy[:, 0] - math.sin(turned) * xy[:, 1]
    north = math.sin(turned) * xy[:, 0] + math.cos(turned) * xy[:, 1]
    # Earth-centred coordinates: across the axis in the meridian of the origin, to its east, along the axis
    radius = _radius(latitude)
    across = radius * math.cos(latitude) - north * math.sin(latitude)
    along = radius * (1.0 - E2) * math.sin(latitude) + north * math.cos(latitude)
    # Back to the ellipsoid: Bowring's formula, exact to rounding near the surface
    distance, b = np.hypot(across, east), A * (1.0 - F)
    beta = np.arctan2(along * A, distance * b)
    found = np.arctan2(along + E2 / (1.0 - E2) * b * np.sin(beta) ** 3, distance - E2 * A * np.cos(beta) ** 3)
    return np.column_stack([np.degrees(longitude + np.arctan2(east, across)), np.degrees(found)])


def places_of_degrees(degrees: Floats, origin: Origin) -> Floats:
    """(N, 2) places [m] on the plane that touches the ellipsoid at an origin; the inverse of `degrees_of`.

    A place is where the plumb line of its longitude and latitude meets the plane.

    Args:
        degrees: (N, 2) longitude and latitude [deg].
        origin: where the plane touches.
    """
    turned, latitude, longitude = np.radians([origin.turned, origin.latitude, origin.longitude]).tolist()
    phi, away = np.radians(degrees[:, 1]), np.radians(degrees[:, 0]) - longitude
    radius = A / np.sqrt(1.0 - E2 * np.sin(phi) ** 2)
    # On the ellipsoid and along its normal, in the meridian of the origin
    normal = np.column_stack([np.cos(phi) * np.cos(away), np.cos(phi) * np.sin(away), np.sin(phi)])
    at = normal * np.column_stack([radius, radius, radius * (1.0 - E2)])
    up = np.array([math.cos(latitude), 0.0, math.sin(latitude)])
    own = _radius(latitude)
    touch = np.array([own * math.cos(latitude), 0.0, own * (1.0 - E2) * math.sin(latitude)])
    height = -((at - touch) @ up) / (normal @ up)
    met = at - touch + height[:, None] * normal
    east, north = met[:, 1], met @ np.array([-math.sin(latitude), 0.0, math.cos(latitude)])
    return np.column_stack(
        [
            math.cos(turned) * east + math.sin(turned) * north,
            -math.sin(turned) * east + math.cos(turned) * north,
        ]
    )


def _radius(latitude: float) -> float:
    """Radius of curvature across the meridian [m] at a latitude [rad]."""
    return A / math.sqrt(1.0 - E2 * math.sin(latitude) ** 2)
