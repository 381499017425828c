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


def array_kernel(function: F) -> F:
    """As `kernel`, for loops that the compiler is to vectorise.

    A division by zero gives inf or NaN as in NumPy, and products may be fused with sums;
    NaN and inf keep their meaning.
    """
    return cast(F, numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})(function))
