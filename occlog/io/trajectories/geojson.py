"""GeoJSON as `occlog export` writes it: a line or a point for each target, with the times of its corners.

The member `origin` of the collection says which place on earth the scene's origin is; without it longitude and latitude
tell no place in the scene.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError
from occlog.io.files.texts.csv_rows import Rows
from occlog.io.files.texts.json_file import parse_json

from .earth import FARTHEST, Origin, places_of_degrees

NAMES = ("t_ns", "target_id", "x_m", "y_m")
COLLECTION = "FeatureCollection"
ORIGIN = "origin"
KEYS = ("latitude", "longitude", "turned_deg")
"""Members of the origin: [deg], and the angle of +x from the east towards the north [deg]."""


def read_geojson(path: Path) -> Iterator[Rows]:
    """Rows of all targets; InputError, with the number of the feature, for what is not such a collection."""
    value = parse_json(path.read_bytes(), path, "GeoJSON")
    features = value.get("features") if isinstance(value, dict) else None
    if not isinstance(features, list) or value.get("type") != COLLECTION:
        raise InputError(f"{path}: is no {COLLECTION}; GeoJSON with a list of features was expected")
    origin = _origin(path, value.get(ORIGIN))
    for number, feature in enumerate(features, start=1):
        identity, t_ns, corners = _feature(path, number, feature)
        xy = places_of_degrees(corners, origin)
        cells = {
            "t_ns": np.array([str(t) for t in t_ns]),
            "target_id": np.full(len(t_ns), str(identity)),
            "x_m": np.array([repr(x) for x in xy[:, 0].tolist()]),
            "y_m": np.array([repr(y) for y in xy[:, 1].tolist()]),
        }
        yield Rows(path, np.full(len(t_ns), number), cells, "feature")


def _origin(path: Path, told: object) -> Origin:
    members: Mapping[str, Any] = told if isinstance(told, dict) else {}
    values: list[Any] = [members.get(key, 0.0 if key == KEYS[2] else None) for key in KEYS]
    if not all(_is_number(v) for v in values):
        raise InputError(
            f'{path}: does not say where the scene lies; add the member "{ORIGIN}": '
            f'{{"{KEYS[0]}": 52.5163, "{KEYS[1]}": 13.3777, "{KEYS[2]}": 0}} beside "features"'
        )
    found = Origin(*(float(v) for v in values))
    if abs(found.latitude) > FARTHEST or abs(found.longitude) > 180:
        raise InputError(f"{path}: {ORIGIN}: latitude must be within {FARTHEST:g} degrees and longitude within 180")
    return found


def _feature(path: Path, number: int, feature: object) -> tuple[int, list[int], Floats]:
    """Identity, times and (n, 2) longitude and latitude of one feature."""
    place = f"{path}: feature {number}"
    properties = _member(feature, "properties")
    shape = _member(feature, "geometry")
    kind, told = shape.get("type"), shape.get("coordinates")
    if kind not in ("LineString", "Point"):
        raise InputError(f"{place}: its geometry is {kind!r}; LineString or Point was expected")
    corners = [told] if kind == "Point" else told
    good = isinstance(corners, list) and all(
        isinstance(corner, list) and len(corner) in (2, 3) and all(_is_number(v) for v in corner) for corner in corners
    )
    if not good or not isinstance(corners, list) or not corners:
        raise InputError(f"{place}: its coordinates are no list of longitudes and latitudes")
    degrees = np.array([corner[:2] for corner in corners], dtype=np.float64)
    if (np.abs(degrees) > (180.0 + 1e-6, 90.0)).any():
        raise InputError(f"{place}: a longitude is beyond 180 degrees, or a latitude beyond 90")
    identity: Any = properties.get("target_id")
    t_ns: Any = properties.get("t_ns")
    if not _is_whole(identity):
        raise InputError(f"{place}: has no whole number target_id among its properties")
    if not isinstance(t_ns, list) or len(t_ns) != len(corners) or not all(_is_whole(t) for t in t_ns):
        raise InputError(f"{place}: wants t_ns, a list of whole numbers, one for each of its {len(corners)} corners")
    return identity, t_ns, degrees


def _member(feature: object, name: str) -> Mapping[str, Any]:
    found = feature.get(name) if isinstance(feature, dict) else None
    return found if isinstance(found, dict) else {}


def _is_number(value: object) -> bool:
    # An integer of hundreds of digits is no float
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= sys.float_info.max


def _is_whole(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)
