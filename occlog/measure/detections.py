"""Output of detection and fusion for a part of a recording, and the height of a person; light to import."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from occlog.records.losses import Loss
    from occlog.records.tables import Bearings, Views

PERSON_HEIGHT = {"m": 1.7, "ft": 5.6, "in": 67.0}
"""Height of a person by the scene's length unit."""


class Detections(NamedTuple):
    """Views, bearings and losses of one part of a recording.

    `frames` counts the frames that gave a result, `warmup` those that only trained the background model.
    """

    views: Views
    bearings: Bearings
    losses: tuple[Loss, ...]
    frames: int  # frames that gave a result
    warmup: int  # frames that only taught the background
