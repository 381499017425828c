"""Inputs of a stage: their digests, and the verdicts stored in them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from occlog.errors import InputError
from occlog.io.files.limits import Content, content_of
from occlog.io.files.provenance import InputDigests, Provenance, hash_file, verdicts_in
from occlog.io.files.tables.parquet import is_ours, read_provenance
from occlog.io.files.texts.documents import read_json
from occlog.records.losses import Loss
from occlog.records.verdicts import Verdict


def hash_inputs(paths: Iterable[Path]) -> InputDigests:
    """File name and SHA-256 of each input file, together with the verdicts stored in the files.

    Names exclude folders, so that outputs do not depend on where files are.
    """
    files = [Path(path) for path in paths]
    found = [(path.name, hash_file(path)) for path in files]
    return InputDigests.of(found, (each for path in dict.fromkeys(files) for each in verdicts_of_file(path)))


def previous_losses(paths: Iterable[Path]) -> tuple[Loss, ...]:
    """Losses recorded in the provenance of input files (tables, recordings and JSON), without duplicates."""
    found: dict[Loss, None] = {}
    for path in paths:
        made = _provenance_of(path)
        found |= dict.fromkeys(() if made is None else made.losses)
        found |= dict.fromkeys(_losses_in(_provenance_in_json(path)))
    return tuple(found)


def verdicts_of_file(path: Path) -> tuple[Verdict, ...]:
    """Verdicts stored in the provenance of a table, recording or JSON file; empty for other or damaged files."""
    made = _provenance_of(path)
    try:
        return verdicts_in(_provenance_in_json(path)) if made is None else made.judged
    except ValueError:
        return ()


def _provenance_of(path: Path) -> Provenance | None:
    """Provenance of a table or recording of occlog; None for other or damaged files.

    A stage that opens a damaged file refuses it itself.
    """
    try:
        content = content_of(path)
        if content is Content.RECORDING:
            from occlog.io.recording.reader import open_recording

            return open_recording(path).provenance
        return read_provenance(path) if content is Content.TABLE and is_ours(path) else None
    except InputError:
        return None


def _losses_in(values: Mapping[str, Any]) -> tuple[Loss, ...]:
    """Losses in the JSON object of a provenance; empty if they are damaged."""
    try:
        return tuple(Loss(**loss) for loss in values.get("losses", ()))
    except TypeError:
        return ()


def _provenance_in_json(path: Path) -> dict[str, Any]:
    """JSON object `_provenance` of a JSON file; empty for other or damaged files."""
    if path.suffix.lower() != ".json" or not path.is_file():
        return {}
    try:
        found = read_json(path).get("_provenance")
    except (InputError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}
