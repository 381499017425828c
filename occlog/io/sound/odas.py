"""Streams of ODAS: sources that it tracks (SST) or finds (SSL), as JSON objects one after another.

An object is a hop of the sound: `{"timeStamp": 17, "src": [{"id": 3, "tag": "dynamic", "x": 0.6, "y": 0.8, "z": 0.0,
"activity": 0.9}, ...]}`; sources that are found but not tracked have `x, y, z, E`.  The time stamp counts hops, whose
length (hopSize / fS) stands in ODAS' configuration alone.  The vector is a unit vector in the array's frame.  An empty
slot has the id 0, or no direction: a hop with empty slots alone heard nobody.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS
from occlog.errors import InputError, UsageError, option
from occlog.records.losses import Loss

from .csv_log import DoaOptions, DoaRows

READ_BYTES = 1 << 18
MAX_OBJECT = 1 << 20
"""Characters of one object: ODAS writes about 100 for a source."""
LENGTHS = (0.9, 1.1)
"""Of a vector that is taken for a direction; ODAS writes three decimals."""
MAX_COUNT = 10**11
"""A greater time stamp is no count of hops: at a hop of 1 ms it would lie three years after the start."""
ROWS_PER_CHUNK = 16_384


class _Hop(NamedTuple):
    """One object of the stream, and the line on which it begins."""

    line: int
    number: int
    sources: list[dict[str, object]]


def looks_like_odas(head: list[str]) -> bool:
    """Whether the first line of a file begins a JSON object."""
    return bool(head) and head[0].lstrip("\ufeff").lstrip().startswith("{")


def read_odas(path: Path, options: DoaOptions, losses: list[Loss]) -> Iterator[DoaRows]:
    """Directions of a stream; an object that the end of the file cuts off is a loss.

    Raises:
        UsageError: the hop or the array is not given.
        InputError: an object is not what ODAS writes; the line is named.
    """
    if options.sensor is None:
        raise UsageError(f"{path}: does not name its array; give it as ARRAY={path.name}")
    if options.hop is None:
        raise UsageError(
            f"{path}: its timeStamp counts hops; state the hop [s] ({option('hop')}), "
            f"hopSize / fS of ODAS' configuration, "
            "for example 0.008 or 128/16000"
        )
    rows: list[tuple[int, int, int, float, float, float]] = []
    for hop in _hops(path, losses):
        t_ns = options.start_ns + round(hop.number * options.hop * NS)
        rows += [(hop.line, t_ns, *source) for source in _sources(path, hop)]
        if len(rows) >= ROWS_PER_CHUNK:
            yield _rows(rows, options.sensor)
            rows = []
    if rows:
        yield _rows(rows, options.sensor)


def parse_hop(text: str) -> Fraction:
    """A hop [s] as a number or a quotient such as 128/16000; UsageError unless it is above 0 and at most 10."""
    try:
        value = Fraction(text.replace(" ", ""))
    except (ValueError, ZeroDivisionError):
        value = Fraction(0)
    if not 0 < value <= 10:
        raise UsageError(f"hop {text!r}: want seconds above 0 and at most 10, for example 0.008 or 128/16000")
    return value


def _hops(path: Path, losses: list[Loss]) -> Iterator[_Hop]:
    """The objects of the file, which is read piece by piece."""
    decoder = json.JSONDecoder(parse_constant=_refuse_constant)
    text, at, line, ended = "", 0, 1, False
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        while True:
            start = _after_blanks(text, at)
            line += text.count("\n", at, start)
            found, end, problem = _decode(decoder, text, start)
            at = start
            if found is not None:
                yield _check(path, line, found)
                line += text.count("\n", at, end)
                at = end
            elif ended:
                if at < len(text):
                    _end(path, line, text[at:], problem, losses)
                return
            elif len(text) - at > MAX_OBJECT:
                raise _malformed(path, line, problem)
            else:
                more = file.read(READ_BYTES)
                text, at, ended = text[at:] + more, 0, not more


def _after_blanks(text: str, at: int) -> int:
    """The place of the next character that is not a blank."""
    while at < len(text) and text[at] in " \t\r\n":
        at += 1
    return at


def _decode(decoder: json.JSONDecoder, text: str, at: int) -> tuple[object, int, str]:
    """The JSON value that begins at a place of the text, and its end; None and the reason where it is not all there."""
    if at >= len(text):
        return None, at, ""
    try:
        found, end = decoder.raw_decode(text, at)
    except (ValueError, RecursionError) as error:
        return None, at, str(error).split(":")[0]
    return found, end, ""


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is no number")


def _end(path: Path, line: int, text: str, problem: str, losses: list[Loss]) -> None:
    """The text after the last whole object: cut off at the end of the file, or damaged."""
    cut = text.startswith("{") and text.count("{") > text.count("}")
    if not cut:
        raise _malformed(path, line, problem)
    losses.append(Loss(path.name, f"line {line}", "the file ends within this object", 1))


def _malformed(path: Path, line: int, problem: str) -> InputError:
    return InputError(
        f"{path}: line {line}: not an object of ODAS ({problem}); objects one after another were expected"
    )


def _check(path: Path, line: int, found: object) -> _Hop:
    """The object as a hop; InputError where it is something else."""
    if not isinstance(found, dict):
        raise _malformed(path, line, f"a JSON {type(found).__name__}")
    count, sources = found.get("timeStamp"), found.get("src")
    if isinstance(count, bool) or not isinstance(count, int) or not 0 <= count <= MAX_COUNT:
        raise InputError(f"{path}: line {line}: timeStamp is {count!r}; a count of hops from 0 was expected")
    if not isinstance(sources, list) or not all(isinstance(s, dict) for s in sources):
        raise InputError(f"{path}: line {line}: src is not a list of sources")
    return _Hop(line, count, sources)


def _sources(path: Path, hop: _Hop) -> Iterator[tuple[int, float, float, float]]:
    """Identity (-1: none), azimuth and elevation in the array's frame [rad] and confidence of each source."""
    for source in hop.sources:
        identity = source.get("id", -1)
        if isinstance(identity, bool) or not isinstance(identity, int) or not -1 <= identity < 2**31:
            raise InputError(f"{path}: line {hop.line}: id is {identity!r}; a whole number was expected")
        x, y, z = (_number(path, hop, source, key) for key in ("x", "y", "z"))
        length = float(np.sqrt(x * x + y * y + z * z))
        if identity == 0 or length == 0.0:
            continue
        if not LENGTHS[0] <= length <= LENGTHS[1]:
            raise InputError(
                f"{path}: line {hop.line}: x, y, z is ({x:g}, {y:g}, {z:g}), of length {length:.3g}; a unit vector was "
                "expected"
            )
        strength = next((_number(path, hop, source, key) for key in ("activity", "E") if key in source), np.nan)
        elevation = float(np.arctan2(z, np.hypot(x, y)))
        yield identity, float(np.arctan2(y, x)), elevation, float(np.clip(strength, 0.0, 1.0))


def _number(path: Path, hop: _Hop, source: dict[str, object], key: str) -> float:
    value = source.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= sys.float_info.max:
        raise InputError(f"{path}: line {hop.line}: {key} of a source is {value!r}; a number was expected")
    return float(value)


def _rows(rows: list[tuple[int, int, int, float, float, float]], sensor: str) -> DoaRows:
    line, t_ns, identity, azimuth, elevation, confidence = zip(*rows, strict=True)
    unknown = np.full(len(rows), np.nan)
    return DoaRows(
        line=np.array(line, dtype=np.int64),
        t_ns=np.array(t_ns, dtype=np.int64),
        sensor=np.full(len(rows), sensor),
        source_id=np.array(identity, dtype=np.int64),
        azimuth=np.array(azimuth, dtype=np.float64),
        elevation=np.array(elevation, dtype=np.float64),
        sigma_azimuth=unknown,
        sigma_elevation=unknown,
        confidence=np.array(confidence, dtype=np.float64),
    )
