"""occlog: recorded multi-camera video and acoustic logs to evaluated tracks.

The names of `occlog.api` are names of this package, too: `occlog.open`, `occlog.track`, `occlog.evaluate` and others.
They are loaded when one of them is first used, so that `import occlog` and the command line start quickly.
"""

from importlib import import_module
from types import ModuleType

__version__ = "0.1.0"


class _Verb(ModuleType):
    """A sub-package that can also be called as the function of the same name in `occlog.api`.

    `occlog.track(...)` tracks, and `import occlog.track.catalogue` imports; signature and docstring are those of the
    function.
    """

    def __call__(self, *args: object, **values: object) -> object:
        return self._function()(*args, **values)

    def __getattr__(self, name: str) -> object:
        if name not in ("__signature__", "__wrapped__"):
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}")
        return self._function() if name == "__wrapped__" else import_module("inspect").signature(self._function())

    @property
    def __doc__(self) -> str | None:  # type: ignore[override]
        doc: str | None = self._function().__doc__
        return doc

    def __reduce__(self) -> object:
        return import_module, (self.__name__,)

    def _function(self):  # type: ignore[no-untyped-def]
        return getattr(import_module("occlog.api"), self.__name__.rpartition(".")[2])


for _name in ("evaluate", "ingest", "report", "simulate", "track"):
    import_module(f"{__name__}.{_name}").__class__ = _Verb
del _name


def __getattr__(name: str) -> object:
    """Return a name of the Python API, loaded on first use.

    Raises:
        AttributeError: the API has no such name.
    """
    if name.startswith("_"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    api = import_module("occlog.api")
    if name not in api.__all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}; it has {', '.join(api.__all__)}")
    value = getattr(api, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the names of this package and of the Python API, sorted."""
    return sorted({*globals(), *import_module("occlog.api").__all__})
