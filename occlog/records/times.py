"""The largest time that occlog takes."""

from __future__ import annotations

MAX_NS = 2**62 - 1
"""Largest time [ns since the Unix epoch, year 2116] and length of time: two of them have a difference in 64 bits."""


def bounded_ns(t_ns: int) -> int:
    """A time [ns] that a file states; ValueError beyond `MAX_NS` before or after the epoch."""
    if not -MAX_NS <= t_ns <= MAX_NS:
        far = f"{t_ns} ns" if abs(t_ns) < 10**24 else f"ns in {len(str(abs(t_ns)))} digits"
        raise ValueError(f"its time of {far} is out of range: 2116 is the last year")
    return t_ns
