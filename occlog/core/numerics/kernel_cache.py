"""Cache of compiled kernels on disk, invalidated when code or a constant changes that they are compiled from.

Numba invalidates a kernel only if the file that defines it changes. Kernels and constants of other files are compiled
into it: here a kernel is valid while its bytecode, that of all functions that it calls and the values that they refer
to are unchanged. Since numba unpickles files of its cache folder, a folder that others can write to is not used, nor
is numba's configuration file in the current folder.
"""

from __future__ import annotations

import enum
import hashlib
import os
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any, NamedTuple

import numpy as np

from occlog.console.foreign_code import hidden, is_own
from occlog.console.notes import note, note_uncached

CONFIGURATION = ".numba_config.yaml"
CACHE_DIR = "NUMBA_CACHE_DIR"

with hidden(CONFIGURATION):
    import numba
    from numba.core import config
    from numba.core.caching import CompileResultCacheImpl, FunctionCache
    from numba.core.types.abstract import Type
    from numba.core.types.containers import BaseTuple

# Numba searches for the file again whenever it compiles; missing of this name, anywhere
config._config_fname = os.devnull
config.reload_config()


EXTERNAL = sys.stdlib_module_names | {"numba", "numpy", "scipy"}
"""Packages with functions that are not compiled into kernels: numba has its own implementations."""
SIMPLE = (bool, int, float, complex, str, bytes, np.generic, np.dtype, Type)
"""Types of values that their text describes."""


def _of_class(given: type) -> object:
    """Describe a class as kernels see it: fields of a named tuple with their defaults, members of an enumeration."""
    fields = getattr(given, "_fields", None)
    if fields is not None:
        inside: object = (fields, sorted(getattr(given, "_field_defaults", {}).items()))
    elif issubclass(given, enum.Enum):
        inside = [(member.name, member.value) for member in given]
    else:
        inside = ()
    return given.__module__, given.__qualname__, inside


def _layouts(given: Any) -> list[object]:
    """Return the descriptions of the named tuples among numba types `given`, at any depth, in their order."""
    if isinstance(given, (tuple, list)):
        return [each for part in given for each in _layouts(part)]
    if isinstance(given, BaseTuple):
        own = [_of_class(given.instance_class)] if hasattr(given, "instance_class") else []
        return own + _layouts(tuple(given))
    return []


class _Parts(NamedTuple):
    """What a function is compiled from.

    Attributes:
        text: its code, its defaults, the options of the compiler, and the values that it refers to.
        calls: functions that it refers to, compiled or not.
    """

    text: str
    calls: tuple[Any, ...]


def _referred(value: Any, names: frozenset[str], calls: list[Any]) -> object:
    """Describe a value that a function refers to; functions are appended to `calls`.

    Args:
        value: any value; what numba cannot compile into a kernel, and a name of the function means by chance alone, is
            described by its class.
        names: names in the function: of a module its attributes of these names count.
        calls: extended in place.
    """
    if hasattr(value, "py_func") or isinstance(value, FunctionType):
        function = getattr(value, "py_func", value)
        if (function.__module__ or "").partition(".")[0] not in EXTERNAL:
            calls.append(value)
        cells = [each for each in _cells(function) if not callable(each)]
        return function.__module__, function.__qualname__, _referred(cells, names, calls)
    if isinstance(value, ModuleType):
        own = value.__name__.partition(".")[0] not in EXTERNAL
        inside = sorted(names & vars(value).keys()) if own else []
        return value.__name__, [(name, _referred(vars(value)[name], names - {name}, calls)) for name in inside]
    if isinstance(value, type):
        return _of_class(value)
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, enum.Enum):
        return _of_class(type(value)), value.name
    if isinstance(value, (set, frozenset)):
        return type(value).__name__, sorted(repr(_referred(each, names, calls)) for each in value)
    if isinstance(value, dict):
        return type(value).__name__, sorted((repr(k), _referred(v, names, calls)) for k, v in value.items())
    if isinstance(value, (tuple, list)):
        return _of_class(type(value)), [_referred(each, names, calls) for each in value]
    if isinstance(value, CodeType):
        return _of_code(value, None, names, calls)
    simple = value is None or value is ... or isinstance(value, SIMPLE)
    return type(value).__name__, repr(value) if simple else getattr(value, "__name__", "")


def _of_code(code: CodeType, docstring: str | None, names: frozenset[str], calls: list[Any]) -> object:
    """Describe bytecode without its place in the file and without the docstring, which compile to nothing."""
    constants = [None if k == 0 and each == docstring else each for k, each in enumerate(code.co_consts)]
    variables = (code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars)
    arguments = (code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount)
    rest = (variables, arguments, getattr(code, "co_exceptiontable", b""))
    return code.co_code, _referred(constants, names, calls), rest


def _names(code: CodeType) -> frozenset[str]:
    """Return the names of globals and attributes in a function, including those in functions inside it."""
    inner = (_names(each) for each in code.co_consts if isinstance(each, CodeType))
    return frozenset(code.co_names).union(*inner)


def _cells(function: FunctionType) -> list[Any]:
    """Return the values that a function inside another one takes from it."""
    return [cell.cell_contents for cell in function.__closure__ or ()]


@cache
def _parts(given: Any) -> _Parts:
    """Return what a function, compiled by numba or not, is compiled from."""
    function = getattr(given, "py_func", given)
    code, calls = function.__code__, []  # type: tuple[CodeType, list[Any]]
    names = _names(code)
    values = (function.__defaults__, function.__kwdefaults__, _cells(function), getattr(given, "targetoptions", {}))
    known = [(name, function.__globals__[name]) for name in sorted(names & function.__globals__.keys())]
    text = (_of_code(code, function.__doc__, names, calls), _referred((values, known), names, calls))
    return _Parts(repr(text), tuple(calls))


def stamp(function: Any) -> str:
    """Return the SHA-256 over numba's version and all that a kernel is compiled from.

    This is its bytecode and that of the functions that it calls, directly or indirectly, with the options of the
    compiler and the values of constants: what numba compiles, wherever it was imported from. Comments, docstrings and
    the number of a line do not count.

    Args:
        function: a compiled function; its module is loaded, so that its globals are known.
    """
    found: dict[Any, str] = {}
    todo = [function]
    while todo:
        each = todo.pop()
        if each not in found:
            parts = _parts(each)
            found[each] = parts.text
            todo += parts.calls
    texts = sorted(found.values())
    return hashlib.sha256("\0".join([numba.__version__, found[function], *texts]).encode()).hexdigest()


@cache
def _chosen() -> Path | None:
    """Return the folder of `NUMBA_CACHE_DIR`, which is created if missing; None if unset or unusable, with a note.

    It is unusable if it is relative, cannot be created, or can be written by others.
    """
    given = os.environ.get(CACHE_DIR, "")
    if not given:
        return None
    folder = Path(given)
    reason = "is relative to the current folder" if not folder.is_absolute() else ""
    if not reason:
        try:
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        except OSError as error:
            reason = f"cannot be made: {error.strerror}"
        else:
            reason = "" if is_own(folder) else "can be written by others"
    if reason:
        note(f"{CACHE_DIR}={given}: {reason}; compiled kernels are kept in the default folder")
        return None
    return folder


def _users() -> Path:
    """Return the folder for kernels in the user's cache folder."""
    from numba.misc.appdirs import AppDirs

    return Path(AppDirs(appname="occlog", appauthor=False).user_cache_dir) / "kernels"


class KernelLocator:
    """Locator of a kernel's cache: `NUMBA_CACHE_DIR`, the program's folder, or the user's cache folder."""

    def __init__(self, folder: Path) -> None:
        """Use `folder` for compiled kernels."""
        self._folder = folder

    @classmethod
    def from_function(cls, function: Callable[..., Any], file: str) -> KernelLocator | None:
        """Return the locator of the first folder that is writable; None without one.

        The order is `NUMBA_CACHE_DIR`, the folder of the source file, the user's cache folder. All but the second must
        be writable by this user only.

        Args:
            function: the kernel; its module's name is used.
            file: source file of the module.
        """
        path = Path(file).resolve()
        depth = function.__module__.count(".") + (path.name == "__init__.py")
        base = path.parents[depth]
        below = path.parent.relative_to(base)
        chosen = _chosen()
        folders = [*([chosen / below] if chosen is not None else []), path.parent / "__pycache__", _users() / below]
        for folder in folders:
            if _usable(folder, trusted=folder.parent == path.parent):
                return cls(folder)
        return None

    def ensure_cache_path(self) -> None:
        """Create the folder if it was removed."""
        self._folder.mkdir(mode=0o700, parents=True, exist_ok=True)

    def get_cache_path(self) -> str:
        """Return the folder of the compiled kernels."""
        return str(self._folder)

    def get_source_stamp(self) -> str:
        """Return an empty digest: `KernelCache` sets that of the kernel once its module is loaded."""
        return ""

    def get_disambiguator(self) -> str:
        """Return an empty text: functions of one name in a file differ in their digest."""
        return ""


@cache
def _usable(folder: Path, trusted: bool) -> bool:
    """Return whether a folder exists or can be created, and is writable; by this user only, unless it is `trusted`.

    A missing folder is created.
    """
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK | os.X_OK) and (trusted or is_own(folder))


class _Files(CompileResultCacheImpl):  # type: ignore[misc]
    """Numba's files of compiled kernels, in the folders of `KernelLocator`."""

    _locator_classes = (KernelLocator,)


class NoCacheError(Exception):
    """No folder for compiled kernels is writable: they are compiled in each process."""


class KernelCache(FunctionCache):  # type: ignore[misc]
    """Numba's disk cache, in trusted folders, with validity by all that a kernel is compiled from.

    An index that refers to removed types or modules is treated as empty.
    """

    _impl_class = _Files

    def __init__(self, compiled: Any) -> None:
        """Choose the folder for a kernel; `compiled` is what numba made of the function.

        Raises:
            NoCacheError: none can be written, as in a container that is read-only.
        """
        self._compiled = compiled
        try:
            super().__init__(compiled.py_func)
        except RuntimeError as error:
            note_uncached()
            raise NoCacheError from error

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        """Return numba's key of the argument types `sig`, with the fields of named tuples among them.

        Called for each loading and saving: the digest of the kernel is set here, before the index is read.
        """
        self._cache_file._source_stamp = stamp(self._compiled)
        return (*super()._index_key(sig, codegen), repr(_layouts(getattr(sig, "args", sig))))

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the compiled kernel for the argument types `sig`; None if it is missing, or cannot be read.

        An unreadable cache is emptied. `target_context` is numba's.
        """
        try:
            return super().load_overload(sig, target_context)
        except (AttributeError, ImportError):
            self.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save the compiled kernel `data` for the argument types `sig`.

        On failure (full disk) a note is made, and only this process has the kernel.
        """
        try:
            super().save_overload(sig, data)
        except OSError:
            note_uncached()
