"""Colours of targets: a target has the same one in the report, over the video and in viewers."""

from __future__ import annotations

TARGETS = ("#0173b2", "#b0488f", "#028e74", "#a85d00", "#5a60c8", "#ca3542")
"""Colours of targets in the order of identities, on a light ground; they repeat after six."""
TARGETS_DARK = ("#4aa8e8", "#e08cc4", "#3cc4a6", "#e0a050", "#a0a6ff", "#ff7f88")
"""Lighter colours of targets in the order of identities, for dark ground and video."""


def target_rgb(index: int, dark: bool = False) -> tuple[int, int, int]:
    """Return the colour (red, green, blue; 0 to 255 each) of a target.

    Args:
        index: position of the target in the order of identities, from 0; colours repeat after six.
        dark: use the lighter colours, for dark backgrounds and video.
    """
    text = (TARGETS_DARK if dark else TARGETS)[index % len(TARGETS)]
    return int(text[1:3], 16), int(text[3:5], 16), int(text[5:7], 16)
