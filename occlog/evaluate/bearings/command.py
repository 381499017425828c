"""Work of `occlog evaluate --truth-azimuths`: directions of arrival against true ones."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from occlog.array_types import NS
from occlog.cli import options
from occlog.errors import InputError, UsageError
from occlog.io.files.json_file import write_json
from occlog.io.files.provenance import Provenance, hash_inputs
from occlog.io.open import open_if_ours, open_input
from occlog.io.sound.csv_log import DoaOptions
from occlog.io.sound.directions import read_doa
from occlog.records.scene import MicrophoneArray
from occlog.records.tables import Doa

from .azimuths import doa_metrics


def run_evaluate_doa(
    doa: Path | None, truth: Path, output: Path | None, gate_deg: float, max_gap_s: float, overwrite: bool
) -> dict[str, Any]:
    """Read, compare, write; the figures.

    Args:
        doa: directions: a table, or a recording that holds them.
        truth: true directions: the same, or a log (CSV: time, azimuth_deg, perhaps sensor).
        output: JSON to write; None: none.
        gate_deg: pairs further apart are a missed and a false direction.
        max_gap_s: a set is compared with the true one nearest in time, at most half of this away.
        overwrite: replace the output.
    """
    if doa is None:
        raise UsageError("--truth-azimuths wants directions to compare; give them with --doa")
    options.check_outputs([doa, truth], [output], overwrite)
    found = open_input(doa).read(Doa)
    if not len(found):
        raise InputError(f"{doa}: has no directions; nothing can be compared")
    metrics = doa_metrics(found, _truth(truth, found), math.radians(gate_deg), round(0.5 * max_gap_s * NS))
    if metrics["doa_found"] == 0:
        raise InputError(f"{truth}: has no time near those of {doa}; look at the times, or give a larger --max-gap")
    if output is not None:
        parameters = {"doa_gate_deg": gate_deg, "max_gap_s": max_gap_s}
        provenance = Provenance("evaluate", parameters, None, hash_inputs([doa, truth]))
        write_json(output, {**metrics, "_provenance": provenance.as_dict()}, overwrite=overwrite)
    return metrics


def _truth(path: Path, found: Doa) -> Doa:
    """True directions; a log without a column of sensors is of the only one that there is."""
    opened = open_if_ours(path)
    if opened is not None:
        return opened.read(Doa)
    names = np.unique(found.sensor).tolist()
    arrays = [MicrophoneArray(name, np.zeros(3)) for name in names]
    sole = names[0] if len(names) == 1 else None
    return Doa.merge(list(read_doa(path, arrays, DoaOptions(sensor=sole))))
