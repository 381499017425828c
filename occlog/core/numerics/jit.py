"""One decorator for all compiled kernels, typed so that callers keep the kernel's annotations."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeVar, cast

from occlog.console.notes import log_compiling

from .kernel_cache import KernelCache, NoCacheError  # before numba, which would read files of the current folder

import numba  # isort: skip
from numba.core import event  # isort: skip
from numba.core.types.misc import unliteral  # isort: skip

F = TypeVar("F", bound=Callable[..., Any])
PATIENCE_S = 2.0
"""Minimum total compilation time [s] that is reported."""


def kernel(function: F) -> F:
    """Return a function compiled with numba: cached on disk, without the GIL, exact floating point.

    A call counts references to every array among its arguments, including those in a NamedTuple, and each count takes
    as long as dozens of products: a kernel called in an inner loop should have few array arguments. With
    NUMBA_DISABLE_JIT=1 it is the plain Python function.
    """
    return _cached(function, numba.njit(nogil=True)(function))


def kernel_part(function: F) -> F:
    """Return a function compiled with numba that is inlined into the kernel that calls it.

    For functions called at one place only: a kernel called by another one is compiled separately, and again, with all
    that it calls, into the caller.
    """
    return cast(F, numba.njit(nogil=True, inline="always")(function))


def array_kernel(function: F) -> F:
    """Return a function compiled as by `kernel`, for loops that the compiler vectorises.

    A division by zero gives inf or NaN as in NumPy, and products may be fused with sums;
    NaN and inf keep their meaning.
    """
    return _cached(function, numba.njit(nogil=True, error_model="numpy", fastmath={"contract"})(function))


def _cached(function: F, compiled: Any) -> F:
    """Give a compiled function the disk cache of this program, in place, and return it.

    Without a writable folder, and with NUMBA_DISABLE_JIT=1, it has no cache.

    Args:
        function: the Python function.
        compiled: what numba made of it.
    """
    if compiled is not function:  # not with NUMBA_DISABLE_JIT=1
        with suppress(NoCacheError):
            compiled._cache = KernelCache(compiled)
        compiled.get_call_template = _of_any_value(compiled.get_call_template)
    return cast(F, compiled)


def _of_any_value(template: Callable[..., Any]) -> Callable[..., Any]:
    """Return a wrapper of a kernel's call template that treats constant arguments as variables.

    For calls by other kernels: numba would compile the kernel, and all that it calls, once more for each constant among
    its arguments.
    """

    def get_call_template(args: Any, kws: Any) -> Any:
        return template([unliteral(a) for a in args], {name: unliteral(a) for name, a in kws.items()})

    return get_call_template


class Stopwatch(event.Listener):  # type: ignore[misc]
    """Measures the compilation time of this process; kernels from the cache take none.

    Kernels are compiled one at a time, including those that a kernel calls: the clock is read at each. A timer thread
    would not run, since numba blocks it.
    """

    def __init__(self, notify: Callable[[], None]) -> None:
        """Call `notify` at each check after more than `PATIENCE_S` of compilation time."""
        self._notify = notify
        self._depth = 0
        self._begin = 0.0
        self._before = 0.0

    def on_start(self, event: event.Event) -> None:  # noqa: ARG002
        """Count the start of a kernel's compilation, which may be inside another one."""
        if self._depth == 0:
            self._begin = time.perf_counter()
        self._depth += 1
        self._check_time()

    def on_end(self, event: event.Event) -> None:  # noqa: ARG002
        """Count the end of a kernel's compilation, and add its time if it was the outermost."""
        self._check_time()
        self._depth -= 1
        if self._depth == 0:
            self._before += time.perf_counter() - self._begin

    def _check_time(self) -> None:
        """Call `notify` if more than `PATIENCE_S` of compilation time has passed."""
        if self._before + time.perf_counter() - self._begin > PATIENCE_S:
            self._notify()


event.register("numba:compile", Stopwatch(log_compiling))
