"""Cache of compiled kernels on disk, invalidated when a source file that they depend on changes.

Numba invalidates a kernel only if the file that defines it changes. Kernels and constants of other files are compiled
into it: here a kernel is valid while all files that its file imports, directly or indirectly, are unchanged. Since
numba unpickles files of its cache folder, a folder that others can write to is not used, nor is numba's configuration
file in the current folder.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from occlog.console.foreign_code import PROGRAM, hidden, is_own
from occlog.console.notes import note, note_uncached

CONFIGURATION = ".numba_config.yaml"
CACHE_DIR = "NUMBA_CACHE_DIR"
_IMPORT = re.compile(rb"^[ \t]*(?:from[ \t]+([.\w]+)[ \t]+import[ \t]+(\([^)]*\)|[^\n#]+)|import[ \t]+([^\n#]+))", re.M)

with hidden(CONFIGURATION):
    import numba
    from numba.core import config
    from numba.core.caching import CompileResultCacheImpl, FunctionCache

# Numba searches for the file again whenever it compiles; missing of this name, anywhere
config._config_fname = os.devnull
config.reload_config()


@cache
def _files_of(name: str, base: str) -> tuple[tuple[str, str], ...]:
    """Return (dotted name, path) of the files of a module and of its parent packages, which Python executes, too.

    Args:
        name: dotted name of a module; what follows a module, such as the name of a function, is ignored.
        base: folder of the top-level package.
    """
    found = []
    path = base
    parts = name.split(".")
    for n, part in enumerate(parts, 1):
        path = os.path.join(path, part)  # noqa: PTH118 -- ten times as fast
        for file in (f"{path}.py", f"{path}{os.sep}__init__.py"):
            if os.path.isfile(file):  # noqa: PTH113
                found.append((".".join(parts[:n]), file))
                break
        else:
            break
    return tuple(found)


@cache
def _read(name: str, path: str) -> tuple[bytes, tuple[str, ...]]:
    """Return the SHA-256 digest of a module's file, and the absolute names that it imports (modules, or names in them).

    Args:
        name: dotted name of the module, for relative imports.
        path: path of its file.
    """
    text = Path(path).read_bytes()
    package = name if path.endswith("__init__.py") else name.rpartition(".")[0]
    names = []
    for origin, imported, plain in _IMPORT.findall(text):
        parts = [part.split()[0].decode() for part in (imported or plain).strip(b"()\n\t ").split(b",") if part.split()]
        if origin:
            start = origin.decode()
            names += [start, *(f"{start}{'' if start.endswith('.') else '.'}{part}" for part in parts)]
        else:
            names += parts
    return hashlib.sha256(text).digest(), tuple({_absolute(each, package) for each in names})


def files_behind(module: str, base: str) -> dict[str, str]:
    """Return the files that a module imports within its package and occlog, directly or indirectly, with its own.

    Args:
        module: dotted name.
        base: folder of its top-level package; for a module without a package, also modules in this folder are included.

    Returns:
        Paths by the dotted names of modules.
    """
    own = module.partition(".")[0]
    bases = {"occlog": str(PROGRAM), own: base}
    neighbours = base if own == module else None
    found: dict[str, str] = {}
    todo = [module]
    while todo:
        name = todo.pop()
        where = bases.get(name.partition(".")[0], neighbours)
        for each, path in _files_of(name, where) if where is not None else ():
            if each not in found and (where != neighbours or "." not in each):
                found[each] = path
                todo += _read(each, path)[1]
    return found


def _absolute(name: str, package: str) -> str:
    """Return the absolute dotted name of an import `name`, which may be relative (with leading dots), in a package."""
    rest = name.lstrip(".")
    up = len(name) - len(rest)
    if not up:
        return name
    base = package.rsplit(".", up - 1)[0] if up > 1 else package
    return f"{base}.{rest}" if rest else base


@cache
def stamp(module: str, base: str) -> str:
    """Return the SHA-256 over numba's version and the source files that a module's kernels depend on, with their names.

    `base` is the folder of the top-level package.
    """
    whole = hashlib.sha256(numba.__version__.encode())
    for name, path in sorted(files_behind(module, base).items()):
        whole.update(name.encode() + b"\0" + _read(name, path)[0])
    return whole.hexdigest()


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

    def __init__(self, function: Callable[..., Any], base: str, folder: Path) -> None:
        """Use `folder` for the compiled kernel of a function; `base` is the folder of its top-level package."""
        self._line = function.__code__.co_firstlineno
        self._module, self._base, self._folder = function.__module__, base, folder

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
                return cls(function, str(base), folder)
        return None

    def ensure_cache_path(self) -> None:
        """Create the folder if it was removed."""
        self._folder.mkdir(mode=0o700, parents=True, exist_ok=True)

    def get_cache_path(self) -> str:
        """Return the folder of the compiled kernels."""
        return str(self._folder)

    def get_source_stamp(self) -> str:
        """Return the digest of the kernel's source files; another one makes the compiled kernel invalid."""
        return stamp(self._module, self._base)

    def get_disambiguator(self) -> str:
        """Return a text that distinguishes functions of one name in a file: the number of the first line."""
        return str(self._line)


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
    """Numba's disk cache, in trusted folders, with validity by all source files.

    An index that refers to removed types or modules is treated as empty.
    """

    _impl_class = _Files

    def __init__(self, function: Callable[..., Any]) -> None:
        """Choose the folder for the compiled kernel of a function.

        Raises:
            NoCacheError: none can be written, as in a container that is read-only.
        """
        try:
            super().__init__(function)
        except RuntimeError as error:
            note_uncached()
            raise NoCacheError from error

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
