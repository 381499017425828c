"""Images to maps of histogram bins; the same as `occlog.core.bin_map`, where trackers find them too."""

from __future__ import annotations

from ..core.bin_map import bin_map, update_bin_map

__all__ = ["bin_map", "update_bin_map"]
