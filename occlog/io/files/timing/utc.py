"""Formatting of times for messages."""

from __future__ import annotations

from datetime import UTC, datetime


def utc(t_ns: int) -> str:
    """Format a time [ns since the Unix epoch] in ISO 8601 (UTC), truncated to ms.

    `N ns` if it is outside of years 1 to 9999.
    """
    seconds, rest = divmod(t_ns, 1_000_000_000)
    try:
        stamp = datetime.fromtimestamp(seconds, UTC)
    except (OverflowError, ValueError, OSError):
        return f"{t_ns} ns"
    return f"{stamp:%Y-%m-%dT%H:%M:%S}.{rest // 1_000_000:03d}Z"


MIN_DATE_NS = 100_000_000_000_000_000
"""Times from 1973-03-03 on [ns] are written as dates; earlier ones count from the start of a recording."""


def time_words(t_ns: int) -> str:
    """Format a time [ns] exactly: as date and time (UTC), or in seconds if it is before 1973-03-03 (`MIN_DATE_NS`)."""
    t_ns = int(t_ns)  # of NumPy, too
    if t_ns < MIN_DATE_NS:
        whole, rest = divmod(abs(t_ns), 1_000_000_000)
        fraction = f"{rest:09d}".rstrip("0")
        return f"{'-' if t_ns < 0 else ''}{whole}{'.' if fraction else ''}{fraction} s"
    fraction = f"{t_ns % 1_000_000_000:09d}"
    short = fraction[:3] + fraction[3:].rstrip("0")
    return utc(t_ns).replace(f".{fraction[:3]}Z", f".{short}Z")
