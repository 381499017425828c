"""How the outputs of `occlog evaluate` were made."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from ..io.parquet import read_provenance
from ..io.provenance import Provenance, hash_inputs
from ..io.recording import open_recording

if TYPE_CHECKING:
    from .evaluate_input import Paths


def provenance_of(paths: Paths, parameters: Mapping[str, Any]) -> Provenance:
    """Parameters, inputs, and what was lost in making the inputs."""
    losses: dict[Any, None] = {}  # of all inputs, each once, in order
    for path in paths.inputs:
        kind = path.suffix.lower()
        if kind == ".mcap":
            losses |= dict.fromkeys(open_recording(path).losses)
        elif kind == ".parquet":
            losses |= dict.fromkeys(read_provenance(path).losses)
    return Provenance("evaluate", dict(parameters), None, hash_inputs(paths.inputs), tuple(losses))
