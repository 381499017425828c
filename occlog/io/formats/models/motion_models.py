"""JSON files of motion models (`occlog fit-motion`) and of path loss models of readers (`occlog fit-readers`).

Also the losses of input recorded in models.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from occlog.array_types import Floats
from occlog.errors import InputError
from occlog.io.files.provenance import Provenance, provenance_from_json
from occlog.io.files.texts.documents import read_json, struct_of, write_json
from occlog.io.open import open_if_ours
from occlog.records.losses import Loss
from occlog.records.names import first_double

Row = Annotated[list[float], Meta(min_length=4, max_length=4)]
Matrix = Annotated[list[Row], Meta(min_length=4, max_length=4)]
Gap = Annotated[list[float | None], Meta(min_length=4, max_length=4)]
MatrixWithGaps = Annotated[list[Gap], Meta(min_length=4, max_length=4)]


class MotionSpec(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """Linear Gaussian motion model x' = A x + N(0, sigma), with x = [u u' v v'] in length units and seconds."""

    occlog_motion: Annotated[Literal[1], Meta(description="version of this format")]
    length_unit: Annotated[Literal["m", "ft", "in", "unit", "px"], Meta(description="unit of every length")]
    step_s: Annotated[float, Meta(gt=0, description="time from x to x' [s]")]
    A: Annotated[Matrix, Meta(description="by rows")]
    sigma: Annotated[Matrix, Meta(description="by rows; symmetric, positive definite")]
    noise: Annotated[
        float | None, Meta(description="standard deviation of the positions that it was fitted to, per axis")
    ] = None
    A_error: Annotated[
        MatrixWithGaps | None, Meta(description="standard errors of A; null: the data do not decide it")
    ] = None
    sigma_error: Annotated[
        MatrixWithGaps | None, Meta(description="standard errors of sigma; null: the data do not decide it")
    ] = None
    fit: Annotated[dict[str, Any], Meta(description="how it was fitted, and how well")] = msgspec.field(
        default_factory=dict
    )
    provenance: Annotated[dict[str, Any], Meta(description="program, options and inputs")] = msgspec.field(
        name="_provenance", default_factory=dict
    )


class MotionModel(NamedTuple):
    """Linear Gaussian motion model x' = A x + N(0, sigma) with the state x = [x, vx, y, vy] over a time step.

    Lengths are in `length_unit`, times in seconds.
    """

    A: Floats  # (4, 4)
    sigma: Floats  # (4, 4), positive definite
    step_s: float
    length_unit: str


def motion_schema() -> dict[str, object]:
    """JSON Schema of motion files."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **msgspec.json.schema(MotionSpec)}


def read_motion(path: Path) -> MotionModel:
    """Read a motion model from a JSON file.

    Raises:
        InputError: a field is invalid, or sigma is not symmetric and positive definite.
    """
    otherwise = "is not a motion file (no `occlog_motion`); make one with `occlog fit-motion`"
    spec = struct_of(read_json(path), MotionSpec, key="occlog_motion", source=path, otherwise=otherwise)
    A, sigma = np.array(spec.A, dtype=np.float64), np.array(spec.sigma, dtype=np.float64)
    _check_numbers(path, spec, A, sigma)
    _check_sigma(path, sigma)
    return MotionModel(A, 0.5 * sigma + 0.5 * sigma.T, spec.step_s, spec.length_unit)


def write_motion(
    path: Path, motion: MotionModel, details: Mapping[str, object], provenance: Provenance, *, overwrite: bool = False
) -> None:
    """Write a motion model as a JSON file, atomically; non-finite values in `details` become null.

    Args:
        path: the file.
        motion: the model.
        details: other fields of MotionSpec: noise, A_error, sigma_error, fit.
        provenance: how it was made.
        overwrite: replace an existing file; else OutputExistsError.
    """
    values = {
        "occlog_motion": 1,
        "length_unit": motion.length_unit,
        "step_s": motion.step_s,
        "A": motion.A.tolist(),
        "sigma": motion.sigma.tolist(),
        **details,
        "_provenance": provenance.as_dict(),
    }
    write_json(path, values, overwrite=overwrite)


def _check_numbers(path: Path, spec: MotionSpec, A: Floats, sigma: Floats) -> None:
    for name, matrix in (("A", A), ("sigma", sigma)):
        if not np.isfinite(matrix).all():
            i, j = np.argwhere(~np.isfinite(matrix))[0]
            raise InputError(f"{path}: {name}: row {i + 1}, column {j + 1} is {matrix[i, j]}; expected a finite number")
    if not np.isfinite(spec.step_s):
        raise InputError(f"{path}: step_s is {spec.step_s}; expected a finite number of seconds above 0")


def _check_sigma(path: Path, sigma: Floats) -> None:
    off = np.abs(sigma - sigma.T)
    if (off > 1e-9 * np.abs(sigma).max()).any():
        i, j = np.unravel_index(int(off.argmax()), off.shape)
        raise InputError(
            f"{path}: sigma is not symmetric: row {i + 1}, column {j + 1} is {sigma[i, j]:g}, "
            f"but row {j + 1}, column {i + 1} is {sigma[j, i]:g}"
        )
    size = np.sqrt(np.abs(np.diag(sigma)))
    # Of the correlations, so that units have no influence.
    least = np.linalg.eigvalsh(sigma / np.outer(size, size)).min() if (np.diag(sigma) > 0).all() else 0.0
    if not least > 1e-12:
        raise InputError(
            f"{path}: sigma is not positive definite; every combination of position and velocity must be disturbed"
        )


Positive = Annotated[float, Meta(gt=0)]
Share = Annotated[float, Meta(gt=0, lt=1)]


class ReaderLoss(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """Path loss parameters of one reader."""

    name: str
    power: Annotated[float, Meta(description="strength at 1 m [dBm]")]
    error: Annotated[float | None, Meta(description="standard error of the power [dB]")] = None
    reads: Annotated[int, Meta(ge=0, description="that it was fitted to; 0: the mean of the other readers")]


class CoverageSpec(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """Signal strength from which a read counts as in range, and the probability that this is wrong."""

    range: Annotated[Positive, Meta(description="of all readers: a tag expected weaker than this is out of range")]
    detection: Annotated[Share, Meta(description="probability that a tag in range is read so strongly in a window")]
    stray: Annotated[Share, Meta(description="probability that a tag out of range is")]


class PathLossSpec(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """Path loss model: strength [dBm] at d metres = power - 10 exponent log10(d) + shadowing + noise."""

    occlog_path_loss: Annotated[Literal[1], Meta(description="version of this format")] = 1
    length_unit: Annotated[Literal["m", "ft", "in", "unit", "px"], Meta(description="unit of every length")]
    height: Annotated[float, Meta(description="of the tags above the floor")]
    exponent: Positive
    noise_db: Annotated[Positive, Meta(description="standard deviation of the white noise of a read [dB]")]
    shadow_db: Annotated[float, Meta(ge=0, description="standard deviation of a reader's shadowing [dB]")]
    shadow_s: Annotated[Positive, Meta(description="time in which the shadowing is forgotten [s]")]
    window_s: Annotated[Positive, Meta(description="window of the fit [s], for which the coverage holds")]
    readers: Annotated[list[ReaderLoss], Meta(min_length=1)]
    coverage: CoverageSpec
    fit: Annotated[dict[str, Any], Meta(description="how it was fitted, and how well")] = msgspec.field(
        default_factory=dict
    )
    provenance: Annotated[dict[str, Any], Meta(description="program, options and inputs")] = msgspec.field(
        name="_provenance", default_factory=dict
    )


def path_loss_schema() -> dict[str, object]:
    """JSON Schema of files of path losses."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **msgspec.json.schema(PathLossSpec)}


def read_path_loss(path: Path) -> PathLossSpec:
    """Read path loss models of tag readers from a JSON file.

    Raises:
        InputError: a field is invalid, or a reader is there twice.
    """
    otherwise = "holds no path losses (no `occlog_path_loss`); make them with `occlog fit-readers`"
    spec = struct_of(read_json(path), PathLossSpec, key="occlog_path_loss", source=path, otherwise=otherwise)
    numbers = {name: getattr(spec, name) for name in ("height", "exponent", "noise_db", "shadow_db", "shadow_s")}
    numbers |= {f"power of reader {r.name}": r.power for r in spec.readers}
    for name, value in numbers.items():
        if not math.isfinite(value):
            raise InputError(f"{path}: {name} is {value}; expected a finite number")
    if (double := first_double([r.name for r in spec.readers])) is not None:
        raise InputError(f"{path}: reader {double} is there twice; keep one", id="duplicate-name")
    return spec


def write_path_loss(path: Path, spec: PathLossSpec, provenance: Provenance, *, overwrite: bool = False) -> None:
    """Write path loss models of tag readers as a JSON file, atomically.

    Args:
        path: the file.
        spec: the models.
        provenance: how they were made.
        overwrite: replace an existing file; else OutputExistsError.
    """
    values = {**msgspec.to_builtins(spec), "_provenance": provenance.as_dict()}
    write_json(path, values, overwrite=overwrite)


def model_losses(paths: Iterable[Path | None]) -> tuple[Loss, ...]:
    """Losses recorded in the provenance of several model files, without duplicates, in the order of the files.

    Args:
        paths: JSON files with `_provenance`, tables or recordings; None is skipped.
    """
    return tuple(dict.fromkeys(loss for path in paths if path is not None for loss in _lost(path)))


def _lost(path: Path) -> tuple[Loss, ...]:
    opened = open_if_ours(path)
    if opened is not None:
        return opened.losses
    made = read_json(path).get("_provenance", {})  # a person who writes a model may state anything there
    return provenance_from_json(json.dumps(made), path).losses if made.get("losses") else ()
