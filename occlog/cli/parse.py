"""Values of options that several commands read alike: names, times, settings."""

from __future__ import annotations

from typing import TYPE_CHECKING

from occlog.errors import UsageError

if TYPE_CHECKING:
    pass


LONGEST_WINDOW_S = 1e9


def parse_names(text: str) -> tuple[str, ...]:
    """Names separated by commas."""
    return tuple(part.strip() for part in text.split(",") if part.strip())


def parse_window(seconds: float) -> int:
    """Nanoseconds; UsageError for what is not finite or longer than times can be apart."""
    return round(parse_seconds("--window", seconds) * 1e9)


def parse_seconds(option: str, seconds: float) -> float:
    """The seconds; UsageError for what is not a number or longer than times can be apart."""
    if seconds != seconds:
        raise UsageError(f"{option} {seconds}: must be a number")
    if not seconds <= LONGEST_WINDOW_S:
        raise UsageError(f"{option} {seconds}: must be at most {LONGEST_WINDOW_S:g} seconds")
    return seconds


def parse_setting(text: str) -> tuple[str, str]:
    """NAME=VALUE."""
    name, equals, value = text.partition("=")
    if not equals or not name.strip():
        raise UsageError(f"--set {text}: want NAME=VALUE")
    return name.strip(), value
