"""Colours of targets: a target has the same one in the report, over the video and in viewers."""

from __future__ import annotations

TARGETS = ("#0173b2", "#b0488f", "#028e74", "#a85d00", "#5a60c8", "#ca3542")
"""In the order of identities; they repeat after six."""


def target_rgb(index: int) -> tuple[int, int, int]:
    """Red, green and blue, 0 to 255, of the target that is the index-th by identity."""
    text = TARGETS[index % len(TARGETS)]
    return int(text[1:3], 16), int(text[3:5], 16), int(text[5:7], 16)
