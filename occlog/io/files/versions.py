"""Versions of what occlog computes and writes with, as they are installed."""

from __future__ import annotations

import platform
import re
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution

DISTRIBUTIONS = (
    *("click", "foxglove-schemas-protobuf", "jinja2", "lz4", "matplotlib", "mcap", "mcap-protobuf-support", "msgspec"),
    *("numba", "numpy", "opencv-python-headless", "pandas", "protobuf", "pyarrow", "pyyaml", "scipy", "shapely"),
    *("tqdm", "zstandard"),
)
"""What occlog cannot do without."""
PARTS = ("clarabel", "llvmlite", "onnxruntime", "openvino", "osqp", "pyroomacoustics", "rosbags")
"""What some commands take where it is installed, and the compiler of the kernels."""
_VERSION = re.compile(r"^Version: *(\S+)", re.MULTILINE)


@cache
def installed_versions() -> dict[str, str]:
    """Version of Python and of each package that is installed, by its name.

    They are the same for every command and process in one environment, so that outputs are the same bytes.
    """
    found = {"python": platform.python_version()}
    for name in (*DISTRIBUTIONS, *PARTS):
        version = _version(name)
        if version is not None:
            found[name] = version
    return dict(sorted(found.items()))


def _version(name: str) -> str | None:
    """Version in the metadata of a package, without the parser of mail, which takes a millisecond for each."""
    try:
        text = distribution(name).read_text("METADATA") or ""
    except (PackageNotFoundError, OSError, UnicodeDecodeError):
        return None
    found = _VERSION.search(text)
    return None if found is None else found[1]
