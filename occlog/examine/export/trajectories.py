"""Places of targets in formats of trajectories: MOTChallenge in space, TUM, GeoJSON, TRC."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints
from occlog.errors import InputError, UsageError
from occlog.io.trajectories.earth import Origin, degrees_of
from occlog.io.trajectories.geojson import COLLECTION, KEYS, ORIGIN
from occlog.records.people import PeopleTracks
from occlog.records.tables import Tracks, Truth
from occlog.settings import METRES


class Places(NamedTuple):
    """Where targets were; N rows in the order of time, then of identities."""

    t_ns: Ints
    identity: Ints
    xyz: Floats  # (N, 3) z 0 where it is not known
    velocity: Floats  # (N, 2) NaN: not known
    confidence: Floats  # (N,) NaN: not known


def check_targets(chunks: Iterable[Tracks | Truth], targets: tuple[int, ...]) -> list[int]:
    """The identities that are written, rising: a pass over the rows.

    Args:
        chunks: of the table.
        targets: identities to keep; none: all.

    Raises:
        InputError: none is left, or an identity is not there.
    """
    known = sorted({identity for part in chunks for identity in np.unique(part.target_id[_used(part)]).tolist()})
    for target in targets:
        if target not in known:
            raise InputError(f"no target {target}; there are: {', '.join(map(str, known)) or 'none'}")
    if not known:
        raise InputError("there are no rows to write")
    return sorted(set(targets)) or known


def _used(table: Tracks | Truth) -> Bools:
    """(N,) rows of targets: of a truth those with the role of one."""
    return table.role == "target" if isinstance(table, Truth) else np.ones(len(table), dtype=np.bool_)


def places_of(table: Tracks | Truth, targets: tuple[int, ...]) -> Places:
    """The targets of a table; of a truth those with the role of one.

    Args:
        table: rows in any order.
        targets: identities to keep; none: all.
    """
    used = _used(table)
    used = used & np.isin(table.target_id, targets) if targets else used
    rows = table.take(used).sorted()
    nothing = np.full(len(rows), np.nan)
    velocity = np.column_stack([nothing, nothing] if isinstance(rows, Truth) else [rows.vx, rows.vy])
    z = np.where(np.isnan(rows.z), 0.0, rows.z)
    sure = rows.existence if isinstance(rows, PeopleTracks) else nothing
    return Places(rows.t_ns, rows.target_id.astype(np.int64), np.column_stack([rows.x, rows.y, z]), velocity, sure)


def mot3d_text(pieces: Iterable[Places]) -> Iterator[str]:
    """Lines `frame,id,-1,-1,-1,-1,confidence,x,y,z`, a text for each piece; frames are the distinct times, from 1.

    A time is in one piece only.
    """
    first = 1
    for places in pieces:
        times, frame = np.unique(places.t_ns, return_inverse=True)
        numbers = (first + frame).tolist()
        rows = zip(numbers, places.identity.tolist(), places.confidence.tolist(), places.xyz.tolist(), strict=True)
        yield "".join(
            f"{f},{identity},-1,-1,-1,-1,{-1 if p != p else repr(p)},{x!r},{y!r},{z!r}\n"
            for f, identity, p, (x, y, z) in rows
        )
        first += len(times)


def check_one_target(names: list[int]) -> None:
    """UsageError for several targets, of which TUM text holds one."""
    if len(names) > 1:
        few = ", ".join(map(str, names[:10])) + (f" and {len(names) - 10} more" if len(names) > 10 else "")
        raise UsageError(f"TUM text holds one target, and there are {few}; choose one (target)")


def tum_text(places: Places) -> str:
    """Lines `t x y z qx qy qz qw` of one target [s]; it looks to where it goes, along +x where that is not known."""
    heading = np.arctan2(places.velocity[:, 1], places.velocity[:, 0])
    half = np.where(np.isnan(heading), 0.0, 0.5 * heading)
    rows = zip(places.t_ns.tolist(), places.xyz.tolist(), np.sin(half).tolist(), np.cos(half).tolist(), strict=True)
    return "".join(f"{_seconds(t_ns)} {x!r} {y!r} {z!r} 0 0 {qz!r} {qw!r}\n" for t_ns, (x, y, z), qz, qw in rows)


def _seconds(t_ns: int) -> str:
    """A time as exact seconds, also one before the epoch."""
    whole, rest = divmod(abs(t_ns), NS)
    return f"{'-' if t_ns < 0 else ''}{whole}.{rest:09d}"


def geojson_text(places: Places, origin: Origin, length_unit: str) -> str:
    """A feature for each target: a line in WGS 84, a point for a target of one row, with the times of its corners."""
    if length_unit not in METRES:
        raise InputError(f"lengths are in {length_unit}, of which the length in metres is not known")
    places_deg = degrees_of(places.xyz[:, :2] * METRES[length_unit], origin)
    features = []
    for name in np.unique(places.identity).tolist():
        own = np.flatnonzero(places.identity == name)
        corners = [[round(lon, 9), round(lat, 9)] for lon, lat in places_deg[own].tolist()]
        shape = (
            {"type": "LineString", "coordinates": corners}
            if len(own) > 1
            else {"type": "Point", "coordinates": corners[0]}
        )
        properties = {"target_id": name, "t_ns": places.t_ns[own].tolist()}
        features.append({"type": "Feature", "geometry": shape, "properties": properties})
    where = {ORIGIN: dict(zip(KEYS, origin, strict=True))}  # so that places in the scene can be read again
    return json.dumps({"type": COLLECTION, **where, "features": features}) + "\n"


def trc_text(places: Places, length_unit: str, name: str) -> str:
    """A table of markers, one a target, with a line for each time; a target that is not there has empty cells.

    The unit is m, or mm for lengths in others than m and mm.
    """
    if length_unit not in METRES:
        raise InputError(f"lengths are in {length_unit}, of which the length in metres is not known")
    unit = length_unit if length_unit in ("m", "mm") else "mm"
    xyz = places.xyz * (METRES[length_unit] / METRES[unit])
    times, frame = np.unique(places.t_ns, return_inverse=True)
    names, marker = np.unique(places.identity, return_inverse=True)
    cells = [["", "", ""] * len(names) for _ in times]
    for row, (f, m) in enumerate(zip(frame.tolist(), marker.tolist(), strict=True)):
        cells[f][3 * m : 3 * m + 3] = [repr(value) for value in xyz[row].tolist()]
    rate = NS / float(np.median(np.diff(times))) if len(times) > 1 else 1.0
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate:g}\t{rate:g}\t{len(times)}\t{len(names)}\t{unit}\t{rate:g}\t1\t{len(times)}",
        "Frame#\tTime\t" + "\t\t\t".join(f"target_{n}" for n in names.tolist()) + "\t\t",
        "\t\t" + "\t".join(f"{axis}{n + 1}" for n in range(len(names)) for axis in "XYZ"),
        "",
    ]
    start = int(times[0])
    lines += [f"{n + 1}\t{(t - start) / NS!r}\t" + "\t".join(cells[n]) for n, t in enumerate(times.tolist())]
    return "\n".join(lines) + "\n"
