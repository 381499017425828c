"""Conversion of geodetic positions (WGS 84) to and from scene coordinates in the tangent plane at an origin.

The user states the origin for all inputs of one command, so that it is kept in a context variable set by the command
line. +x points east and +y north, unless the origin states a rotation; z points up.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.console.notes import note_once
from occlog.errors import InputError, UsageError, option

A, F = 6_378_137.0, 1 / 298.257223563
"""Half axis [m] and flattening of the ellipsoid of WGS 84."""
E2 = F * (2.0 - F)
FARTHEST = 85.0
"""Latitude [deg] beyond which an origin is refused."""
MAX_DISTANCE_M = 100_000.0
"""Positions farther from the origin are refused: latitude and longitude are exchanged, or it is of another scene."""
MAX_EXCHANGED_DEG = 2.0
"""Latitude and longitude are named as exchanged if the position is this near to the origin then."""
MAX_HEIGHT_M = 100_000.0
LATITUDES = ("lat", "latitude", "lat_deg", "latitude_deg")
LONGITUDES = ("lon", "lng", "long", "longitude", "lon_deg", "longitude_deg")
HEIGHTS = ("alt", "altitude", "alt_m", "altitude_m", "ele", "height", "height_m")
"""Names of columns, in lower case."""
FORM = "LAT,LON[,DEG[,HEIGHT]]"


class Origin(NamedTuple):
    """Geodetic position (WGS 84) of the scene's origin, rotation of its x axis, and height of its ground."""

    latitude: float  # [deg]
    longitude: float  # [deg]
    turned: float = 0.0  # angle of +x from the east towards the north [deg]
    height: float | None = None  # of the ground, in the datum of the heights of inputs [m]; None: heights are not used


class StatedOrigin:
    """The scene's geodetic origin that the user states (`origin`), and whether an input needed it (`used`)."""

    def __init__(self, origin: Origin) -> None:
        """Wrap the origin that the user states, which is not used so far."""
        self.origin = origin
        self.used = False

    def text(self) -> str:
        """The origin as `origin=LAT,LON,DEG[,HEIGHT]`, for provenance."""
        given = [value for value in self.origin if value is not None]
        return "origin=" + ",".join(f"{value:.10g}" for value in given)


STATED_ORIGIN: ContextVar[StatedOrigin | None] = ContextVar("STATED_ORIGIN", default=None)


def parse_origin(text: str) -> Origin:
    """Parse LAT,LON[,DEG[,HEIGHT]]: degrees north and east, angle of +x from the east [deg], height of z = 0 [m].

    Raises:
        UsageError: the text is anything else, or the latitude is beyond +-85 degrees.
    """
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) not in (2, 3, 4) or not all(math.isfinite(value) for value in values):
        raise UsageError(f"origin: {text!r} is not {FORM}, as 52.5163,13.3777")
    if abs(values[0]) > FARTHEST or abs(values[1]) > 180:
        raise UsageError(f"origin: latitude must be within {FARTHEST:g} degrees and longitude within 180")
    return Origin(*values)


@contextmanager
def stated_origin(text: str) -> Iterator[StatedOrigin]:
    """Context manager that sets the geodetic origin for inputs read within its block.

    `text` is LAT,LON[,DEG[,HEIGHT]]; UsageError for an invalid one.
    """
    found = StatedOrigin(parse_origin(text))
    token = STATED_ORIGIN.set(found)
    try:
        yield found
    finally:
        STATED_ORIGIN.reset(token)


def begin_positions() -> None:
    """Record that an input has geodetic positions, so that the stated origin counts as used."""
    if (stated := STATED_ORIGIN.get()) is not None:
        stated.used = True


def origin_is_unused() -> bool:
    """Whether an origin is stated although no input has geodetic positions."""
    stated = STATED_ORIGIN.get()
    return stated is not None and not stated.used


def has_heights() -> bool:
    """Whether geodetic heights of inputs are used: the user's origin states its own height."""
    stated = STATED_ORIGIN.get()
    return stated is not None and stated.origin.height is not None


def note_unused_heights(where: str) -> None:
    """Note once, if the user's origin states no height, that the heights in the input `where` are not used."""
    stated = STATED_ORIGIN.get()
    if stated is not None and stated.origin.height is None:
        note_once(f"note: {where}: heights are not used; {option('origin')} {FORM} states the height of z = 0")


def positions_on_earth(degrees: Floats, heights: Floats | None, where: str) -> Floats:
    """(N, 3) scene positions [m] of geodetic positions (WGS 84), with the origin that the user states.

    Args:
        degrees: (N, 2) longitude and latitude [deg].
        heights: (N,) in the datum of the origin's height [m]; None: unknown.
        where: the file, and the position in it, for errors.

    Returns:
        x, y, z. Without heights, or a height of the origin, z is 0, and x, y are the point at which the plumb line of
            the position meets the plane z = 0.

    Raises:
        UsageError: no origin is stated; the message suggests the first position.
        InputError: a latitude or longitude is out of range, or too far from the origin.
    """
    if not np.isfinite(degrees).all():
        raise InputError(f"{where}: a latitude or longitude is not a number; leave the row out")
    if heights is not None and not (np.abs(heights) < MAX_HEIGHT_M).all():
        raise InputError(f"{where}: an altitude is not a number within {MAX_HEIGHT_M:g} m; leave the row out")
    if (np.abs(degrees) > (180.0, 90.0)).any():
        longitude, latitude = degrees[(np.abs(degrees) > (180.0, 90.0)).any(axis=1)][0].tolist()
        raise InputError(
            f"{where}: latitude {latitude:g} and longitude {longitude:g} are not on the earth; are they exchanged?"
        )
    stated = STATED_ORIGIN.get()
    if stated is None:
        longitude, latitude = degrees[0].tolist() if len(degrees) else (13.3777, 52.5163)
        raise UsageError(
            f"{where}: has latitudes and longitudes; state where the scene's origin is: {option('origin')} "
            f"{latitude:.7f},{longitude:.7f} (its first position)",
            id="missing-value",
        )
    stated.used, origin = True, stated.origin
    if origin.height is None or heights is None:
        found = np.column_stack([places_of_degrees(degrees, origin), np.zeros(len(degrees))])
    else:
        found = scene_of_earth(degrees, heights, origin)
    # A position beyond a quarter of the earth has no plumb line to the plane
    distance = np.where(_cosine(degrees, origin) > 0.5, np.hypot(found[:, 0], found[:, 1]), np.inf)
    if (distance > MAX_DISTANCE_M).any():
        bad = int(np.argmax(distance > MAX_DISTANCE_M))
        longitude, latitude = degrees[bad].tolist()
        exchanged = abs(longitude - origin.latitude) + abs(latitude - origin.longitude) < MAX_EXCHANGED_DEG
        remedy = (
            f"exchange latitude and longitude, in the file or in {option('origin')}"
            if exchanged
            else "correct the origin, or leave out rows without a fix (0,0)"
        )
        raise InputError(
            f"{where}: {latitude:g},{longitude:g} is more than {MAX_DISTANCE_M / 1000:g} km from the origin "
            f"{origin.latitude:g},{origin.longitude:g}; {remedy}"
        )
    return found


def _cosine(degrees: Floats, origin: Origin) -> Floats:
    """(N,) cosine of the central angle between the origin and positions, on a sphere.

    `degrees` (N, 2) are longitude and latitude [deg].
    """
    phi, away = np.radians(degrees[:, 1]), np.radians(degrees[:, 0] - origin.longitude)
    own = math.radians(origin.latitude)
    return np.asarray(np.sin(phi) * math.sin(own) + np.cos(phi) * math.cos(own) * np.cos(away))


def scene_of_earth(degrees: Floats, heights: Floats, origin: Origin) -> Floats:
    """(N, 3) exact scene positions (x, y, up) [m] of geodetic positions, via earth-centred coordinates.

    Args:
        degrees: (N, 2) longitude and latitude [deg].
        heights: (N,) in the datum of the origin's height [m].
        origin: origin and rotation of the scene; a height of None is 0.
    """
    turned, latitude, longitude = np.radians([origin.turned, origin.latitude, origin.longitude]).tolist()
    phi, away = np.radians(degrees[:, 1]), np.radians(degrees[:, 0]) - longitude
    at = _earth_centred(phi, away, heights)
    own = _earth_centred(np.array([latitude]), np.zeros(1), np.array([origin.height or 0.0]))
    d = at - own
    sine, cosine = math.sin(latitude), math.cos(latitude)
    return _turned(d[:, 1], cosine * d[:, 2] - sine * d[:, 0], turned, cosine * d[:, 0] + sine * d[:, 2])


def _earth_centred(phi: Floats, away: Floats, heights: Floats) -> Floats:
    """(N, 3) earth-centred, earth-fixed coordinates [m] of positions; x points to longitude 0, z along the axis.

    Args:
        phi: (N,) geodetic latitudes [rad].
        away: (N,) longitudes [rad] from the meridian that is to have longitude 0.
        heights: (N,) above the ellipsoid [m].
    """
    radius = A / np.sqrt(1.0 - E2 * np.sin(phi) ** 2)
    across = (radius + heights) * np.cos(phi)
    along = (radius * (1.0 - E2) + heights) * np.sin(phi)
    return np.column_stack([across * np.cos(away), across * np.sin(away), along])


def _turned(east: Floats, north: Floats, turned: float, *up: Floats) -> Floats:
    """Scene coordinates (N, 2) of east and north coordinates (N,), or (N, 3) with `up` (N,) appended.

    `turned` is the angle of the scene's x axis [rad] from the east towards the north.
    """
    x = math.cos(turned) * east + math.sin(turned) * north
    y = -math.sin(turned) * east + math.cos(turned) * north
    return np.column_stack([x, y, *up])


def degrees_of(xy: Floats, origin: Origin) -> Floats:
    """(N, 2) longitude and latitude [deg] of scene positions `xy` (N, 2) [m] in the tangent plane at the origin."""
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
    east_of_greenwich = np.degrees(longitude + np.arctan2(east, across))
    # Longitudes beyond the 180th meridian continue at -180 degrees
    east_of_greenwich -= 360.0 * np.sign(east_of_greenwich) * (np.abs(east_of_greenwich) > 180.0)
    return np.column_stack([east_of_greenwich, np.degrees(found)])


def places_of_degrees(degrees: Floats, origin: Origin) -> Floats:
    """(N, 2) scene positions [m] of longitudes and latitudes without heights; the inverse of `degrees_of`.

    A position is where the plumb line of its longitude and latitude meets the tangent plane z = 0.

    Args:
        degrees: (N, 2) longitude and latitude [deg].
        origin: point at which the plane touches the ellipsoid, and rotation of the scene.
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
    return _turned(east, north, turned)


def _radius(latitude: float) -> float:
    """Radius of curvature of the WGS 84 ellipsoid in the prime vertical [m] at a latitude [rad]."""
    return A / math.sqrt(1.0 - E2 * math.sin(latitude) ** 2)
