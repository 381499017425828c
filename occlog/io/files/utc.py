"""Times for people to read."""

from __future__ import annotations

from datetime import UTC, datetime


def utc(t_ns: int) -> str:
    """Write a time [ns since the Unix epoch] in ISO format to the millisecond, computed from the integer."""
    seconds, rest = divmod(t_ns, 1_000_000_000)
    try:
        stamp = datetime.fromtimestamp(seconds, UTC)
    except (OverflowError, ValueError, OSError):
        return f"{t_ns} ns"
    return f"{stamp:%Y-%m-%dT%H:%M:%S}.{rest // 1_000_000:03d}Z"
