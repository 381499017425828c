"""What tracking costs the network: messages and bytes, and what the selection of cameras saves.

Every camera that is asked sends one message a scan, whether it sees the target or not: its
name (2 bytes), the time (8), and a reading with its standard deviation (4 each).  When
the selection changes, every camera that is switched on or off gets a message with its name
and the order (4 bytes).
"""

from __future__ import annotations

import numpy as np

from occlog.records.tables import Diagnostics

REPORT_BYTES = 18
ORDER_BYTES = 4


class Messages:
    """Counts over the chunks of the diagnostics."""

    def __init__(self) -> None:
        """Nothing yet."""
        self.reports = 0
        self.offered = 0
        self.orders = 0
        self.selections = 0
        self._on: dict[int, frozenset[str]] = {}

    def add(self, part: Diagnostics) -> None:
        """Count some more scans."""
        self.reports += int(part.n_looked.sum())
        self.offered += int(part.n_offered.sum())
        for row in np.flatnonzero(np.isfinite(part.predicted_mse)).tolist():
            target = int(part.target_id[row])
            now = frozenset(name for name in part.selected[row].split(",") if name)
            self.orders += len(now ^ self._on.get(target, frozenset()))
            self.selections += 1
            self._on[target] = now

    @property
    def bytes(self) -> int:
        """Sent in all."""
        return self.reports * REPORT_BYTES + self.orders * ORDER_BYTES

    def summary(self) -> dict[str, float | int]:
        """The figures; those of the selection only where there was one."""
        counts: dict[str, float | int] = {"messages": self.reports + self.orders, "bytes": self.bytes}
        if self.selections:
            whole = self.offered * REPORT_BYTES
            counts |= {
                "selections": self.selections,
                "bytes_of_all_cameras": whole,
                "bytes_saved": 1.0 - self.bytes / whole if whole else 0.0,
            }
        return counts
