"""Path losses of readers as JSON files: what `occlog fit-readers` writes and tracking by reads takes."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from occlog.errors import InputError
from occlog.io.files.provenance import Provenance
from occlog.io.files.texts.json_file import read_json, struct_of, write_json
from occlog.records.names import first_double

Positive = Annotated[float, Meta(gt=0)]
Share = Annotated[float, Meta(gt=0, lt=1)]


class ReaderLoss(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """One reader."""

    name: str
    power: Annotated[float, Meta(description="strength at 1 m [dBm]")]
    error: Annotated[float | None, Meta(description="standard error of the power [dB]")] = None
    reads: Annotated[int, Meta(ge=0, description="that it was fitted to; 0: the mean of the other readers")]


class CoverageSpec(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """From which strength on a read counts, as that of a tag in range, and how often that is wrong."""

    range: Annotated[Positive, Meta(description="of all readers: what is weaker than expected there is out of range")]
    detection: Annotated[Share, Meta(description="probability that a tag in range is read so strongly in a window")]
    stray: Annotated[Share, Meta(description="probability that a tag out of range is")]


class PathLossSpec(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """A read at d metres has the strength power - 10 exponent log10(d) + shadowing + noise."""

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
    """Read a file of path losses; InputError, one line, names the field that is wrong."""
    otherwise = "holds no path losses (no `occlog_path_loss`); make them with `occlog fit-readers`"
    spec = struct_of(read_json(path), PathLossSpec, key="occlog_path_loss", source=path, otherwise=otherwise)
    numbers = {name: getattr(spec, name) for name in ("height", "exponent", "noise_db", "shadow_db", "shadow_s")}
    numbers |= {f"power of reader {r.name}": r.power for r in spec.readers}
    for name, value in numbers.items():
        if not math.isfinite(value):
            raise InputError(f"{path}: {name} is {value}; want a finite number")
    if (double := first_double([r.name for r in spec.readers])) is not None:
        raise InputError(f"{path}: reader {double} is there twice; keep one")
    return spec


def write_path_loss(path: Path, spec: PathLossSpec, provenance: Provenance, *, overwrite: bool = False) -> None:
    """Write path losses, whole or not at all."""
    values = {**msgspec.to_builtins(spec), "_provenance": provenance.as_dict()}
    write_json(path, values, overwrite=overwrite)
