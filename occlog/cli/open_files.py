"""How many files this process may have open: each decoding process takes four, and there is one for each video."""

from __future__ import annotations

from contextlib import suppress

with suppress(ImportError):  # no such limits on Windows
    import resource

WANTED = 65_536
"""Open files that are enough for some thousands of cameras."""


def allow_open_files() -> None:
    """Raise the limit that may be raised, which is often 1024, as far as is wanted and allowed."""
    if "resource" in globals():
        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        most = WANTED if hard == resource.RLIM_INFINITY else min(hard, WANTED)
        if soft != resource.RLIM_INFINITY and soft < most:
            with suppress(ValueError, OSError):
                resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))


def open_files_limit() -> int | None:
    """The limit as it is now; None where there is none."""
    if "resource" not in globals():
        return None
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return None if soft == resource.RLIM_INFINITY else soft
