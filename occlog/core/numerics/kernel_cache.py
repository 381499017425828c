"""Where compiled kernels are kept on disk, and which of them are still those of the program's text.

Numba keeps a compiled kernel while the file that defines it is the same.  The kernels of other files that it calls,
and the constants that it takes from them, are compiled into it: here a kernel is kept while all files are the same that
its file imports, directly or through others.  Numba unpickles what it finds in its folder, so that a folder counts
only if others cannot write into it; the configuration file that numba reads in the current folder is not read.
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
    """The file of a module and those of the packages above it, which Python runs, too, by their dotted names.

    Args:
        name: dotted; what follows a module, as the name of a function, counts for nothing.
        base: folder that the top package lies in.
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
    """The digest of a module's file, and what it imports by absolute names: modules, or what is in them."""
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
    """The files that a module imports, directly or through others, with its own: those of its package and of occlog.

    Args:
        module: dotted name.
        base: folder that its top package lies in; of a module without a package also its neighbours count.

    Returns:
        paths by the dotted names of modules.
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
    """The dotted name of an import that begins with dots, from within a package."""
    rest = name.lstrip(".")
    up = len(name) - len(rest)
    if not up:
        return name
    base = package.rsplit(".", up - 1)[0] if up > 1 else package
    return f"{base}.{rest}" if rest else base


@cache
def stamp(module: str, base: str) -> str:
    """SHA-256 over the files that stand behind the kernels of a module, with their names."""
    whole = hashlib.sha256(numba.__version__.encode())
    for name, path in sorted(files_behind(module, base).items()):
        whole.update(name.encode() + b"\0" + _read(name, path)[0])
    return whole.hexdigest()


@cache
def _chosen() -> Path | None:
    """The folder of `NUMBA_CACHE_DIR`; None where missing, or one into which others can write."""
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
    """The folder of the user for what can be made again."""
    from numba.misc.appdirs import AppDirs

    return Path(AppDirs(appname="occlog", appauthor=False).user_cache_dir) / "kernels"


class KernelLocator:
    """The position of a kernel's file: `NUMBA_CACHE_DIR`, the folder of the program, or in the user's cache folder."""

    def __init__(self, function: Callable[..., Any], base: str, folder: Path) -> None:
        """Keep a function, the top package of which lies in `base`, in `folder`."""
        self._line = function.__code__.co_firstlineno
        self._module, self._base, self._folder = function.__module__, base, folder

    @classmethod
    def from_function(cls, function: Callable[..., Any], file: str) -> KernelLocator | None:
        """The first position that can be written, and only by this user; None: missing."""
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
        """Make the folder, should it be gone since it was chosen."""
        self._folder.mkdir(mode=0o700, parents=True, exist_ok=True)

    def get_cache_path(self) -> str:
        """The folder."""
        return str(self._folder)

    def get_source_stamp(self) -> str:
        """What the kernel is made of."""
        return stamp(self._module, self._base)

    def get_disambiguator(self) -> str:
        """Distinguishes functions of one name."""
        return str(self._line)


@cache
def _usable(folder: Path, trusted: bool) -> bool:
    """Whether a folder is there or can be made, and can be written; by this user alone unless it is the program's."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK | os.X_OK) and (trusted or is_own(folder))


class _Files(CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes = (KernelLocator,)


class NoCacheError(Exception):
    """No folder for compiled kernels can be written: they are compiled in each process."""


class KernelCache(FunctionCache):  # type: ignore[misc]
    """Numba's cache on disk, in folders of the user's own, of kernels that are still those of the text.

    An index is unpickled before numba asks whether it is fresh; one that names types or modules that are gone counts
    as empty.
    """

    _impl_class = _Files

    def __init__(self, function: Callable[..., Any]) -> None:
        """Choose the folder.

        Raises:
            NoCacheError: none can be written, as in a container that is read-only.
        """
        try:
            super().__init__(function)
        except RuntimeError as error:
            note_uncached()
            raise NoCacheError from error

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled kernel for a signature; None where missing."""
        try:
            return super().load_overload(sig, target_context)
        except (AttributeError, ImportError):
            self.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled kernel; where that fails, as on a full disk, it serves this process alone."""
        try:
            super().save_overload(sig, data)
        except OSError:
            note_uncached()
