"""What was lost in making a model: motion, path losses, fundamental matrices."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

from occlog.io.files.provenance import provenance_from_json
from occlog.io.files.texts.json_file import read_json
from occlog.io.open import open_if_ours
from occlog.records.losses import Loss


def lost_in_models(paths: Iterable[Path | None]) -> tuple[Loss, ...]:
    """Losses of several models, each once, in the order of the files; None has none.

    Args:
        paths: JSON files with what a model was made of in `_provenance`, or recordings that hold one.
    """
    return tuple(dict.fromkeys(loss for path in paths if path is not None for loss in _lost(path)))


def _lost(path: Path) -> tuple[Loss, ...]:
    opened = open_if_ours(path)
    if opened is not None:
        return opened.losses
    made = read_json(path).get("_provenance", {})  # somebody who writes a model may say anything there
    return provenance_from_json(json.dumps(made), path).losses if made.get("losses") else ()
