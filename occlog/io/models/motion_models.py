"""Motion models as JSON files: what `occlog fit-motion` writes and batch tracking reads."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from occlog.array_types import Floats
from occlog.errors import InputError
from occlog.io.files.provenance import Provenance
from occlog.io.files.texts.json_file import read_json, struct_of, write_json

Row = Annotated[list[float], Meta(min_length=4, max_length=4)]
Matrix = Annotated[list[Row], Meta(min_length=4, max_length=4)]
Gap = Annotated[list[float | None], Meta(min_length=4, max_length=4)]
MatrixWithGaps = Annotated[list[Gap], Meta(min_length=4, max_length=4)]


class MotionSpec(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """A linear Gaussian motion model: x' = A x + N(0, sigma), x = [u u' v v'], in length units and seconds."""

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
    """A motion model and the unit of its lengths."""

    A: Floats  # (4, 4)
    sigma: Floats  # (4, 4), positive definite
    step_s: float
    length_unit: str


def motion_schema() -> dict[str, object]:
    """JSON Schema of motion files."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **msgspec.json.schema(MotionSpec)}


def read_motion(path: Path) -> MotionModel:
    """The model in a file; InputError, one line, names the field that is wrong."""
    otherwise = "is not a motion file (no `occlog_motion`); make one with `occlog fit-motion`"
    spec = struct_of(read_json(path), MotionSpec, key="occlog_motion", source=path, otherwise=otherwise)
    A, sigma = np.array(spec.A, dtype=np.float64), np.array(spec.sigma, dtype=np.float64)
    _check_numbers(path, spec, A, sigma)
    _check_sigma(path, sigma)
    return MotionModel(A, 0.5 * sigma + 0.5 * sigma.T, spec.step_s, spec.length_unit)


def write_motion(
    path: Path, motion: MotionModel, details: Mapping[str, object], provenance: Provenance, *, overwrite: bool = False
) -> None:
    """Write a model, whole or not at all; what is not finite in `details` becomes null.

    Args:
        path: file to write.
        motion: the model.
        details: other fields of MotionSpec: noise, A_error, sigma_error, fit.
        provenance: how it was made.
        overwrite: replace a file that exists.
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
            raise InputError(f"{path}: {name}: row {i + 1}, column {j + 1} is {matrix[i, j]}; want a finite number")
    if not np.isfinite(spec.step_s):
        raise InputError(f"{path}: step_s is {spec.step_s}; want a finite number of seconds above 0")


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
