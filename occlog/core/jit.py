"""One decorator for all compiled kernels, typed so that callers keep the kernel's annotations."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])


def kernel(function: F) -> F:
    """The function compiled by numba: cached on disk, without the GIL, exact floating point.

    With NUMBA_DISABLE_JIT=1 it is the plain Python function.
    """
    return cast(F, numba.njit(cache=True, nogil=True)(function))
