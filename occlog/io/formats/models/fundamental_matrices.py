"""Fundamental matrices as JSON, in a file or attached to a recording (output of `occlog epipolar`).

Also matches of points in two views, from a text table.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta

from occlog.array_types import Floats
from occlog.errors import InputError
from occlog.io.files.provenance import Provenance
from occlog.io.files.texts.documents import parse_json, read_json, struct_of, write_json
from occlog.io.files.texts.formats import RAW, FormatColumn, TextFormat, read_format
from occlog.io.open import open_if_ours
from occlog.io.recording.reader import McapRecording
from occlog.records.view_pairs import PointMatches, ViewPair, ViewPairs

EPIPOLAR_ATTACHMENT = "epipolar.json"
LARGE_PX = 1_000.0
Row = Annotated[list[float], Meta(min_length=3, max_length=3)]
Name = Annotated[str, Meta(min_length=1, description="name of a camera")]
Length = Annotated[float, Meta(ge=0)]


class PairSpec(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """Fundamental matrix F of two views: b' F a = 0 for homogeneous pixels a, b (x, y, 1) of one point."""

    a: Name
    b: Name
    matrix: Annotated[list[Row], Meta(min_length=3, max_length=3, description="F by rows")]
    source: Literal["calibration", "matches"] = "matches"
    noise_px: Annotated[Length | None, Meta(description="standard deviation of a coordinate of the matches")] = None
    error_px: Annotated[Length | None, Meta(description="expected error of the lines")] = None
    undistorted: Annotated[
        bool, Meta(description="for pixels of which the scene's lens distortion was taken, else for recorded ones")
    ] = False
    affine: Annotated[bool, Meta(description="parallel rays")] = False
    matches: Annotated[int, Meta(ge=0, description="matches it was estimated from")] = 0
    inliers: Annotated[int, Meta(ge=0, description="those that agree with it")] = 0
    parallax_px: Annotated[Length | None, Meta(description="how far the matches are from those of a plane")] = None


class EpipolarSpec(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """Content of a file with fundamental matrices between the views of a recording."""

    occlog_epipolar: Annotated[Literal[1], Meta(description="version of this format")] = 1
    pairs: Annotated[list[PairSpec], Meta(min_length=1, description="each pair once, in either order")]
    provenance: Annotated[dict[str, Any], Meta(description="program, options and inputs")] = msgspec.field(
        name="_provenance", default_factory=dict
    )


def epipolar_schema() -> dict[str, object]:
    """JSON Schema of epipolar files."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **msgspec.json.schema(EpipolarSpec)}


def read_epipolar(path: Path) -> ViewPairs:
    """Read pairs of views with fundamental matrices from a JSON file or a recording; InputError if there are none."""
    opened = open_if_ours(path, "a JSON file of fundamental matrices, or a recording that holds some")
    if opened is not None and opened.recording is not None:
        found = attached_epipolar(opened.recording)
        if found is None:
            raise InputError(f"{path}: holds no epipolar geometry; make it with `occlog epipolar`", id="wrong-content")
        return found
    return _pairs(read_json(path), str(path))


def attached_epipolar(recording: McapRecording) -> ViewPairs | None:
    """Pairs of views with fundamental matrices that are attached to a recording; None without an attachment."""
    raw = recording.attachment(EPIPOLAR_ATTACHMENT)
    if raw is None:
        return None
    where = f"{recording.path}: {EPIPOLAR_ATTACHMENT}"
    return _pairs(parse_json(raw, where, "epipolar geometry"), where)


def write_epipolar(path: Path, pairs: ViewPairs, provenance: Provenance, *, overwrite: bool = False) -> None:
    """Write fundamental matrices of pairs of cameras as a JSON file, atomically.

    Args:
        path: the file.
        pairs: pairs of cameras and their matrices.
        provenance: how they were made.
        overwrite: replace an existing file; else OutputExistsError.
    """
    write_json(path, _values(pairs, provenance), overwrite=overwrite)


def epipolar_bytes(pairs: ViewPairs, provenance: Provenance) -> bytes:
    """JSON text of fundamental matrices, as `write_epipolar` writes it, as bytes for an attachment of a recording."""
    return (json.dumps(_values(pairs, provenance), sort_keys=True, indent=2) + "\n").encode()


def _values(pairs: ViewPairs, provenance: Provenance) -> dict[str, object]:
    return {
        "occlog_epipolar": 1,
        "pairs": [{**pair._asdict(), "matrix": pair.matrix.tolist(), **_lengths(pair)} for pair in pairs.pairs],
        "_provenance": provenance.as_dict(),
    }


def _lengths(pair: ViewPair) -> dict[str, float | None]:
    """Noise, error and parallax [px] of a pair for JSON; null if unknown."""
    lengths = {"noise_px": pair.noise_px, "error_px": pair.error_px, "parallax_px": pair.parallax_px}
    return {name: float(value) if np.isfinite(value) else None for name, value in lengths.items()}


def _pairs(values: object, where: str) -> ViewPairs:
    otherwise = "is not epipolar geometry (no `pairs`); make it with `occlog epipolar`"
    spec = struct_of(values, EpipolarSpec, key="pairs", source=where, otherwise=otherwise)
    seen: list[frozenset[str]] = []
    pairs = []
    for n, each in enumerate(spec.pairs):
        names = frozenset((each.a, each.b))
        if len(names) < 2:
            raise InputError(f"{where}: pairs[{n}]: a and b are both {each.a!r}; name two cameras")
        if names in seen:
            raise InputError(
                f"{where}: pairs[{n}]: cameras {each.a} and {each.b} are there twice; remove one", id="duplicate-name"
            )
        seen.append(names)
        pairs.append(_pair(each, f"{where}: pairs[{n}] ({each.a}, {each.b})"))
    return ViewPairs(tuple(pairs))


def _pair(spec: PairSpec, where: str) -> ViewPair:
    matrix = _sized(np.array(spec.matrix, dtype=np.float64))
    _check_matrix(matrix, where)
    lengths = {name: np.nan if (v := getattr(spec, name)) is None else v for name in ("noise_px", "error_px")}
    parallax = np.nan if spec.parallax_px is None else spec.parallax_px
    return ViewPair(
        spec.a,
        spec.b,
        matrix / np.linalg.norm(matrix),
        spec.source,
        **lengths,
        undistorted=spec.undistorted,
        affine=spec.affine,
        matches=spec.matches,
        inliers=spec.inliers,
        parallax_px=parallax,
    )


def _sized(matrix: Floats) -> Floats:
    """Scale a matrix exactly, by a power of two, so that its largest entry is 0.5 to 1 in magnitude.

    Unchanged if it is 0 or not finite.
    """
    largest = np.abs(matrix).max()
    return np.ldexp(matrix, -np.frexp(largest)[1]) if 0.0 < largest < np.inf else matrix


def _check_matrix(matrix: Floats, where: str) -> None:
    """InputError unless a matrix (3, 3) is finite and of rank 2, up to rounding in a text file."""
    if not np.isfinite(matrix).all():
        raise InputError(f"{where}: the matrix has an entry that is not a finite number", id="invalid-calibration")
    scale = np.diag([LARGE_PX, LARGE_PX, 1.0])  # so that coordinates are about 1
    size = np.linalg.svd(scale @ matrix @ scale, compute_uv=False)
    if not size[1] > 1e-9 * size[0]:
        raise InputError(
            f"{where}: the matrix is all 0 or of rank 1; a fundamental matrix has rank 2", id="invalid-calibration"
        )
    if size[2] > 0.02 * size[1]:
        raise InputError(
            f"{where}: the matrix is far from rank 2, which a fundamental matrix has; correct its numbers",
            id="invalid-calibration",
        )


POINTS = ("xa_px", "ya_px", "xb_px", "yb_px")
FORMAT = TextFormat(
    "a table of matches of two views",
    {name: FormatColumn((name,), RAW) for name in ("sensor_a", "sensor_b")}
    | {name: FormatColumn((name,)) for name in POINTS},
)


def read_matches(path: Path) -> tuple[PointMatches, ...]:
    """Read point matches of each pair of views from a text table, in order of first appearance.

    Rows for (a, b) and (b, a) are of one pair. InputError, with the line, for invalid rows.
    """
    names: list[tuple[str, str]] = []
    points: dict[tuple[str, str], list[np.ndarray]] = {}
    lines: dict[tuple[str, str], list[int]] = {}
    for part in read_format(path, FORMAT):
        rows, values = part.rows, np.column_stack([part[name] for name in POINTS])
        for n, pair in enumerate(zip(part["sensor_a"].tolist(), part["sensor_b"].tolist(), strict=True)):
            if pair[0] == pair[1] or not all(pair):
                raise rows.fail(n, f"sensor_a {pair[0]!r} and sensor_b {pair[1]!r} must name two cameras")
            turned = pair[::-1] in points
            key = pair[::-1] if turned else pair
            if key not in points:
                names.append(key)
            points.setdefault(key, []).append(np.roll(values[n], 2) if turned else values[n])
            lines.setdefault(key, []).append(int(rows.lines[n]))
    return tuple(_matches(path, pair, np.array(points[pair]), lines[pair]) for pair in names)


def _matches(path: Path, pair: tuple[str, str], values: np.ndarray, lines: list[int]) -> PointMatches:
    where = f"{path}: lines {lines[0]} to {lines[-1]}: {pair[0]} and {pair[1]}"
    return PointMatches(*pair, values[:, :2], values[:, 2:], where)
