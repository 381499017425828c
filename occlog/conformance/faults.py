"""Shared parts of the kits: a fault with its name, and checks of all kinds of plug-ins."""

from __future__ import annotations

import gc
import io
import os
import pickle
import random
import tracemalloc
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from occlog.settings import Settings


class Fault(NamedTuple):
    """A promise that a plug-in breaks: the name of the check that failed, and a sentence that states how."""

    check: str
    sentence: str


class BrokenError(Exception):
    """Raised by a check that finds a fault in a plug-in; the message states how its promise is broken."""


Check = Callable[[Any], None]
"""Tries a promise of a class; BrokenError states how it is broken."""


@contextmanager
def called(what: str, *refusals: type[Exception]) -> Iterator[None]:
    """Context manager that turns any error of the code inside into a BrokenError.

    Args:
        what: words for the call in the message.
        refusals: classes of exceptions that are raised as they are.
    """
    try:
        yield
    except Exception as error:
        if isinstance(error, (BrokenError, *refusals)):
            raise
        raise BrokenError(f"{what} raises {words(error)}") from error


def words(error: BaseException) -> str:
    """Return the type and message of an error in one line, the message cut to 120 characters."""
    return f"{type(error).__name__}: {' '.join(str(error).split())[:120]}"


def defaults(of: Any, length_unit: str = "m") -> Settings:
    """Return the default settings of the plug-in class `of` for lengths in `length_unit`."""
    found: Settings = of.settings.in_unit(length_unit)
    return found


def check_interface(of: Any) -> None:
    """Check that a plug-in class has a summary of one line, and settings that are a dataclass derived from Settings."""
    if not isinstance(of.summary, str) or not of.summary.strip() or "\n" in of.summary:
        raise BrokenError("the plug-in's summary must be one line of text")
    if not (isinstance(of.settings, type) and issubclass(of.settings, Settings) and is_dataclass(of.settings)):
        raise BrokenError("the plug-in's settings must be a dataclass that derives from Settings")


def check_settings(of: Any) -> None:
    """Check that all settings are declared with a help text, and have valid defaults in every unit."""
    for f in fields(of.settings):
        reported = f.metadata.get("setting")
        if reported is None or not reported.help.strip():
            raise BrokenError(f"the plug-in's setting {f.name} has no help text; declare it by setting() with one")
    for unit in ("m", "cm", "ft", "cell"):
        try:
            of.settings.in_unit(unit)
        except Exception as error:
            raise BrokenError(
                f"the plug-in's settings: defaults for scenes in {unit} are not valid ({error}); correct them or their "
                "limits"
            ) from error


def bytes_left(steps: Iterable[object], first: int) -> float:
    """Return the bytes of memory that a step leaves behind, on average over all steps after the `first` ones.

    `steps`: generator that does one step for each item; it must have more than `first` items.
    """
    size, count = 0, 0
    tracemalloc.start()
    try:
        for count, _ in enumerate(steps, start=1):
            if count == first:
                gc.collect()
                size = tracemalloc.get_traced_memory()[0]
        gc.collect()
        return (tracemalloc.get_traced_memory()[0] - size) / (count - first)
    finally:
        tracemalloc.stop()


def refuse(fault: str | None, what: str = "") -> None:
    """Raise BrokenError if there is a fault; `what`: words for the call, before the fault."""
    if fault is not None:
        raise BrokenError(f"{what}: {fault}" if what else fault)


def step_unchanged(step: Callable[[Any, Any], object], own: object, given: Any, what: str) -> None:
    """Run a step with a named tuple, and raise BrokenError if it changes an array of it; `what`: words for the tuple.

    The first two fields are numbers or names.
    """
    before = [np.array(values) for values in given[2:]]
    step(own, given)
    for name, was, now in zip(given._fields[2:], before, given[2:], strict=True):
        if was.tobytes() != np.asarray(now).tobytes():
            raise BrokenError(f"the plug-in's step changes {name} of the {what} that it is given; copy it")


def named(namespace: Mapping[str, Check]) -> dict[str, Check]:
    """Return the functions of a namespace that are called check_..., by the names of the checks."""
    return {
        name.removeprefix("check_").replace("_", "-"): check
        for name, check in namespace.items()
        if name.startswith("check_")
    }


FIRST: dict[str, Check] = {"interface": check_interface, "settings": check_settings}
"""Checks that end the run if they fail."""


def manners(use: Callable[[Any], object], what: str, *, growth_bytes: int = 0) -> dict[str, Check]:
    """Return the checks that apply to plug-ins of every kind, by name: equal results, no output, no side effects.

    Args:
        use: function that uses a plug-in class in an ordinary way, and returns the outputs for comparison.
        what: name of the plug-in's method, for messages.
        growth_bytes: memory that one use may leave behind [bytes]; 0: memory is not checked.
    """

    def check_determinism(of: Any) -> None:
        if use(of) != use(of):
            raise BrokenError(
                f"the plug-in's {what} gives other results for equal inputs and seed; use the given generator alone"
            )

    def check_global_random(of: Any) -> None:
        def state() -> str:
            shared = dict(np.random.get_state(legacy=False))  # noqa: NPY002 - external state is inspected, not used
            return f"{random.getstate()} {pickle.dumps(shared)!r}"

        before = state()
        use(of)
        if state() != before:
            raise BrokenError(
                "the plug-in uses the global generator of random or numpy.random; use the one that it is given"
            )

    def check_output(of: Any) -> None:
        out, err = io.StringIO(), io.StringIO()
        with redirect_stdout(out), redirect_stderr(err):
            use(of)
        if out.getvalue() or err.getvalue():
            statement = (out.getvalue() + err.getvalue()).strip()
            raise BrokenError(
                f"the plug-in's {what} writes on standard output or error: {statement[:60]!r}; leave this out"
            )

    def check_warnings(of: Any) -> None:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            use(of)
        if caught:
            raise BrokenError(
                f"the plug-in warns of ordinary input, {caught[0].category.__name__}: {caught[0].message}"
            )

    def check_surroundings(of: Any) -> None:
        def state() -> tuple[object, ...]:
            return sorted(p.name for p in Path().iterdir()), str(Path.cwd()), dict(os.environ), np.geterr()

        before = state()
        use(of)
        if state() != before:
            raise BrokenError(
                "the plug-in changes the working folder, the environment or NumPy's error state; restore them"
            )

    def check_memory(of: Any) -> None:
        grown = bytes_left((use(of) for _ in range(2 + USES)), 2)
        if grown > growth_bytes:
            raise BrokenError(
                f"the plug-in's memory grows by {grown:.0f} bytes each use (allowed: {growth_bytes}); keep nothing"
            )

    found: dict[str, Check] = {
        "determinism": check_determinism,
        "global-random": check_global_random,
        "output": check_output,
        "warnings": check_warnings,
        "surroundings": check_surroundings,
    }
    return found | ({"memory": check_memory} if growth_bytes else {})


USES = 5
"""Number of repetitions in the test for growing memory."""


def faults_by(checks: Mapping[str, Check], of: Any) -> list[Fault]:
    """Run the checks on the plug-in class `of`, and return the faults found, in the order of the checks.

    What the plug-in prints and warns is discarded. After a fault of the interface itself (`FIRST`) no further check is
    run. A check that raises another error than BrokenError counts as a fault, too.
    """
    found = []
    for name, check in checks.items():
        try:
            with warnings.catch_warnings(), redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
                if name != "warnings":
                    warnings.simplefilter("ignore")
                check(of)
        except BrokenError as broken:
            found.append(Fault(name, str(broken)))
            if name in FIRST:
                break
        except Exception as error:
            found.append(Fault(name, f"it cannot be tried: {words(error)}"))
    return found
