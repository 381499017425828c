"""What a packed run says of itself: `pack.json`."""

from __future__ import annotations

import unicodedata
from pathlib import PurePosixPath
from typing import Annotated

import msgspec

from occlog.errors import InputError

MANIFEST = "pack.json"
LOCK = "lock.txt"
INPUTS, OUTPUTS = "inputs", "run"
"""Folders of the archive."""
MADE = "occlog-verify"
"""Run folder of a run that may lie anywhere, when it is made again."""
MAX_MANIFEST_BYTES = 16_000_000
LONGEST_NAME = 1000

Sha256 = Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$")]
Size = Annotated[int, msgspec.Meta(ge=0)]


class PackedFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One file.

    Attributes:
        path: its name below the folder of inputs, or the run folder.
        sha256: of its bytes.
        bytes: its size.
        included: whether it is in the archive.
    """

    path: str
    sha256: Sha256
    bytes: Size
    included: bool = True


class Manifest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A packed run.

    Attributes:
        occlog_pack: version of this format.
        version: of occlog.
        versions: of Python and of packages, by name.
        config: name of the configuration among the inputs.
        folder: where the run folder lies among the inputs: a recording that `ingest` made says so where its videos are.
        inputs: the configuration, and all that it names.
        outputs: what the run made.
        stages: exit code of each stage.
    """

    occlog_pack: Annotated[int, msgspec.Meta(ge=1, le=1)]
    version: str
    versions: dict[str, str]
    config: str
    folder: str
    inputs: list[PackedFile]
    outputs: list[PackedFile]
    stages: dict[str, int]

    def members(self) -> dict[str, PackedFile]:
        """Files of the archive by their names in it."""
        inputs = {f"{INPUTS}/{file.path}": file for file in self.inputs if file.included}
        return inputs | {f"{OUTPUTS}/{file.path}": file for file in self.outputs}


def manifest_bytes(manifest: Manifest) -> bytes:
    """The text of `pack.json`, the same each time."""
    text = msgspec.json.format(msgspec.json.encode(manifest, order="sorted"), indent=2)
    return text + b"\n"


def read_manifest(data: bytes, where: str) -> Manifest:
    """A manifest whose names all stay in their folders; InputError for anything else."""
    try:
        manifest = msgspec.json.decode(data, type=Manifest)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"{where}: not a manifest of `occlog pack` ({error}); pack the run again") from error
    check_names(manifest, where, "it is not unpacked")
    if any(f"{key_of_name(file.path)}/".startswith(f"{key_of_name(manifest.folder)}/") for file in manifest.inputs):
        raise InputError(f"{where}: has inputs in its run folder {manifest.folder!r}; pack the run again")
    if manifest.config not in {file.path for file in manifest.inputs}:
        raise InputError(f"{where}: its configuration {manifest.config!r} is not among its inputs; pack the run again")
    return manifest


def check_names(manifest: Manifest, where: str, so: str) -> None:
    """InputError, which ends with `so`, for names that no archive has, or two that some systems take for one."""
    for place, files in ((INPUTS, manifest.inputs), (OUTPUTS, manifest.outputs)):
        met: dict[str, str] = {}
        for file in files:
            check_name(f"{place}/{file.path}", where, so)
            key = key_of_name(file.path)
            if key in met:
                both = f"{met[key]!r} and {file.path!r}"
                raise InputError(f"{where}: names a file twice where case does not count, {both}; {so}")
            met[key] = file.path
    check_name(manifest.folder, where, so)


def key_of_name(name: str) -> str:
    """What a name has in common with those that some systems take for the same: by case, and by how accents are put."""
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", name).casefold())


def check_name(name: str, where: str, so: str) -> None:
    """InputError, which ends with `so`, for a name that leads out of its folder, or that other programs misread.

    A colon is in many names of recordings, for their time, and leads nowhere on the systems that occlog runs on.
    """
    parts = name.split("/")
    bad = (
        len(name) > LONGEST_NAME or any(part in ("", ".", "..") for part in parts) or PurePosixPath(name).is_absolute()
    )
    if bad or "\\" in name or not name.isprintable():
        raise InputError(f"{where}: {name[:80]!r} is no name of a file inside the archive; {so}")


def lock_text(manifest: Manifest) -> bytes:
    """Exact versions as pip takes them, Python's in a comment."""
    packages = {name: version for name, version in manifest.versions.items() if name != "python"}
    lines = [f"# Python {manifest.versions.get('python', '?')}", f"occlog=={manifest.version}"]
    return "\n".join([*lines, *(f"{name}=={version}" for name, version in sorted(packages.items())), ""]).encode()
