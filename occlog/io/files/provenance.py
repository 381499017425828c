"""Provenance of a file: program, versions, parameters, seed and inputs; no clock time, no host name."""

from __future__ import annotations

import hashlib
import importlib
import json
import os
import platform
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import msgspec

from occlog import __version__
from occlog.errors import InputError, spelled
from occlog.records.losses import Loss
from occlog.records.verdicts import Check, Verdict, distinct

from .geodetic import STATED_ORIGIN
from .input_units import STATED

DISTRIBUTIONS = (
    *("click", "foxglove-schemas-protobuf", "jinja2", "lz4", "matplotlib", "mcap", "mcap-protobuf-support", "msgspec"),
    *("numba", "numpy", "opencv-python-headless", "pandas", "protobuf", "pyarrow", "pyyaml", "scipy", "shapely"),
    *("tqdm", "zstandard"),
)
"""Required packages."""
PARTS = ("clarabel", "llvmlite", "onnxruntime", "openvino", "osqp", "pyroomacoustics", "rosbags")
"""Optional packages, and the compiler of the kernels."""
_VERSION = re.compile(r"^Version: *(\S+)", re.MULTILINE)


@cache
def installed_versions() -> dict[str, str]:
    """Versions of Python and of the installed packages that occlog uses, by name.

    They are the same for every command and process in one environment, so that outputs are the same bytes.
    """
    found = {"python": platform.python_version()}
    for name in (*DISTRIBUTIONS, *PARTS):
        version = _version(name)
        if version is not None:
            found[name] = version
    return dict(sorted(found.items()))


CODE_PATHS = ("OPENBLAS_CORETYPE", "NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES", "NPY_DISABLE_CPU_FEATURES")
"""Variables of the environment by which libraries take the code of another processor."""


def processor_type() -> str:
    """Processor type as LLVM (Numba) names it, and the set environment variables that select code for another type.

    Libraries have code for each type with another order of summation, so that the last digits of results differ.
    """
    name: str = importlib.import_module("llvmlite.binding").get_host_cpu_name()
    return " ".join([name, *(f"{key}={os.environ[key]}" for key in CODE_PATHS if key in os.environ)])


def _version(name: str) -> str | None:
    """Version of an installed package, read directly from its metadata file for speed; None if unknown."""
    try:
        text = distribution(name).read_text("METADATA") or ""
    except (PackageNotFoundError, OSError, UnicodeDecodeError):
        return None
    found = _VERSION.search(text)
    return None if found is None else found[1]


PROVENANCE_KEY = "occlog.provenance"
READERS_USED: dict[str, Mapping[str, object]] = {}
"""Plug-in readers in use, with their settings, by the name of the file read."""


class InputDigests(tuple[tuple[str, str], ...]):
    """(file name, SHA-256) of each input of a stage; `verdicts` are those stored in these files.

    Every output made from the files also stores the verdicts.
    """

    verdicts: tuple[Verdict, ...] = ()

    @classmethod
    def of(cls, files: Iterable[tuple[str, str]], verdicts: Iterable[Verdict]) -> InputDigests:
        """Create from (file name, SHA-256) pairs and verdicts, of which equal ones are kept once."""
        made = cls(files)
        made.verdicts = distinct(verdicts)
        return made


def _stated() -> tuple[str, ...]:
    """Units and geodetic origin that the user states for all inputs of the command, as texts for provenance."""
    origin = STATED_ORIGIN.get()
    return (*STATED.get().texts(), *((origin.text(),) if origin is not None else ()))


@dataclass(frozen=True)
class Provenance:
    """Provenance stored in every output: how it was made, and from what.

    Attributes:
        command: the occlog command, e.g. "detect".
        parameters: JSON-ready values of every option that changes the result.
        seed: seed of the random numbers, None if there is none.
        inputs: (file name, SHA-256) of every input, in a fixed order.
        losses: input that was lost so far, also in earlier stages.
        input_units: units that the user stated for columns of inputs, and the geodetic origin of the scene.
        readers: for each input that a plug-in has read, its name, the plug-in and its settings; None: as now in use.
        version: of occlog; empty: not known.
        versions: of Python and of the packages that are installed, by name; empty: not known.
        verdicts: of this stage and of those before it, in their order; None: those of the inputs, if these are
            `InputDigests`.
    """

    command: str
    parameters: Mapping[str, object] = field(default_factory=dict)
    seed: int | None = None
    inputs: tuple[tuple[str, str], ...] = ()
    losses: tuple[Loss, ...] = ()
    input_units: tuple[str, ...] = field(default_factory=_stated)
    readers: tuple[Mapping[str, object], ...] | None = None
    version: str = __version__
    versions: Mapping[str, str] = field(default_factory=installed_versions)
    verdicts: tuple[Verdict, ...] | None = None

    def __post_init__(self) -> None:
        if self.verdicts is None:
            carried = self.inputs.verdicts if isinstance(self.inputs, InputDigests) else ()
            object.__setattr__(self, "verdicts", carried)  # frozen for all other people
        if self.readers is None:
            names = dict.fromkeys(name for name, _ in self.inputs)
            found = tuple({"file": name, **READERS_USED[name]} for name in names if name in READERS_USED)
            object.__setattr__(self, "readers", found)  # frozen for all other people

    @property
    def judged(self) -> tuple[Verdict, ...]:
        """Verdicts of earlier stages and of this one, in their order."""
        return self.verdicts or ()

    def with_checks(self, checks: Iterable[Check]) -> Provenance:
        """Copy with the verdict of this stage, made from its checks, appended to those of the inputs."""
        return replace(self, verdicts=distinct((*self.judged, Verdict.of(self.command, checks))))

    def as_dict(self) -> dict[str, object]:
        """JSON-compatible values of the provenance; empty input_units, readers, versions and verdicts are omitted."""
        return {
            "program": "occlog",
            "version": self.version,
            "command": self.command,
            "parameters": dict(self.parameters),
            "seed": self.seed,
            "inputs": [{"name": name, "sha256": digest} for name, digest in self.inputs],
            "losses": [loss.as_dict() for loss in self.losses],
            **({"input_units": list(self.input_units)} if self.input_units else {}),
            **({"readers": [dict(reader) for reader in self.readers]} if self.readers else {}),
            **({"versions": dict(self.versions)} if self.versions else {}),
            **({"verdicts": msgspec.to_builtins(self.verdicts)} if self.verdicts else {}),
        }

    def json(self) -> str:
        """Provenance as one line of JSON with sorted keys."""
        return spelled(json.dumps(self.as_dict(), sort_keys=True, default=str))


UNKNOWN = Provenance("unknown", input_units=(), readers=(), version="", versions={}, verdicts=())
"""Provenance of external files."""


def provenance_from_json(text: str | bytes, where: Path) -> Provenance:
    """Parse the provenance of the file `where`, as written by `Provenance.json`; `UNKNOWN` for an empty text.

    Raises:
        InputError: the text is damaged. It has the losses of earlier stages, so that a table without it would seem to
            have none.
    """
    if not text:
        return UNKNOWN
    try:
        raw = json.loads(text)
        inputs = tuple((str(i["name"]), str(i["sha256"])) for i in raw.get("inputs", ()))
        losses = tuple(Loss(**loss) for loss in raw.get("losses", ()))
        units = tuple(str(text) for text in raw.get("input_units", ()))
        readers = tuple(dict(each) for each in raw.get("readers", ()))
        version, versions = str(raw.get("version", "")), {str(k): str(v) for k, v in raw.get("versions", {}).items()}
        command, parameters = str(raw["command"]), dict(raw["parameters"])
        verdicts = verdicts_in(raw)
        return Provenance(
            command, parameters, raw.get("seed"), inputs, losses, units, readers, version, versions, verdicts
        )
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(
            f"{where}: its provenance is damaged ({type(error).__name__}), so that earlier losses are "
            "unknown; make it again",
            id="damaged-file",
        ) from error


def verdicts_in(raw: Mapping[str, object]) -> tuple[Verdict, ...]:
    """Verdicts in `raw`, the JSON object of a provenance; ValueError if damaged."""
    return msgspec.convert(raw.get("verdicts", []), tuple[Verdict, ...])


def files_in(folder: Path) -> list[Path]:
    """All files in a folder and its subfolders, sorted."""
    return sorted(path for path in folder.rglob("*") if path.is_file())


def hash_file(path: Path) -> str:
    """SHA-256 of a file's content in hexadecimal; of a folder, that of the names and hashes of the files in it.

    InputError if it cannot be read.
    """
    if path.is_dir():
        held = tuple((file.relative_to(path).as_posix(), hash_file(file)) for file in files_in(path))
        return hashlib.sha256(repr(held).encode()).hexdigest()
    try:
        with Path(path).open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}", id="unreadable-file") from error
