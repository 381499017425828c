"""occlog: recorded multi-camera video and acoustic logs to evaluated tracks.

The names of `occlog.api` are names of this package, too: `occlog.open`, `occlog.track`, `occlog.evaluate` and others.
They are loaded when one of them is first used, so that `import occlog` and the command line start quickly.
"""

__version__ = "0.1.0"

# Folders that are called like functions of the API: Python makes a folder an attribute of its package when it is loaded
# first, here, so that it cannot replace the function later
for _name in ("evaluate", "ingest", "report", "simulate", "track"):
    __import__(f"{__name__}.{_name}")
    del globals()[_name]
del _name


def __getattr__(name: str) -> object:
    """A name of the API, which is loaded here."""
    if name.startswith("_"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    api = import_module("occlog.api")
    if name not in api.__all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}; it has {', '.join(api.__all__)}")
    value = getattr(api, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """The names of the API."""
    from importlib import import_module

    return sorted({*globals(), *import_module("occlog.api").__all__})
