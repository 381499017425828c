"""Archive of a packed run: a ZIP file with reproducible bytes, and safe unpacking.

`pack.json` describes the run.
"""

from __future__ import annotations

import hashlib
import shutil
import stat
import unicodedata
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import IO, Annotated

import msgspec

from occlog.errors import InputError, OutputError
from occlog.io.files.limits import check_input

MANIFEST = "pack.json"
LOCK = "lock.txt"
INPUTS, OUTPUTS = "inputs", "run"
"""Folders of the archive."""
MADE = "occlog-verify"
"""Run folder of a run of any location, when it is made again."""
MAX_MANIFEST_BYTES = 16_000_000
LONGEST_NAME = 1000

Sha256 = Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$")]
Size = Annotated[int, msgspec.Meta(ge=0)]


class PackedFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A file of a packed run.

    Attributes:
        path: its name, relative to the folder of inputs or to the run folder.
        sha256: SHA-256 of its content.
        bytes: its size.
        included: whether it is in the archive.
    """

    path: str
    sha256: Sha256
    bytes: Size
    included: bool = True


class Manifest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Manifest of a packed run.

    Attributes:
        occlog_pack: version of this format.
        version: version of occlog.
        versions: versions of Python and of packages, by name.
        config: name of the configuration among the inputs.
        folder: path of the run folder among the inputs; a recording made by `ingest` refers to its videos from there.
        inputs: the configuration, and all files that it names.
        outputs: files that the run made.
        stages: exit code of each stage.
        processor: type of the processor that it was packed on; empty: unknown.
    """

    occlog_pack: Annotated[int, msgspec.Meta(ge=1, le=1)]
    version: str
    versions: dict[str, str]
    config: str
    folder: str
    inputs: list[PackedFile]
    outputs: list[PackedFile]
    stages: dict[str, int]
    processor: str = ""

    def members(self) -> dict[str, PackedFile]:
        """Return the files in the archive by their names in it."""
        inputs = {f"{INPUTS}/{file.path}": file for file in self.inputs if file.included}
        return inputs | {f"{OUTPUTS}/{file.path}": file for file in self.outputs}


def manifest_bytes(manifest: Manifest) -> bytes:
    """Return the content of `pack.json`; equal manifests give equal bytes."""
    text = msgspec.json.format(msgspec.json.encode(manifest, order="sorted"), indent=2)
    return text + b"\n"


def read_manifest(data: bytes, where: str) -> Manifest:
    """Parse the content of `pack.json`; InputError for other content, and for names that lead out of their folders.

    `where`: name of the archive in messages.
    """
    try:
        manifest = msgspec.json.decode(data, type=Manifest)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(
            f"{where}: not a manifest of `occlog pack` ({error}); pack the run again", id="unknown-format"
        ) from error
    check_names(manifest, where, "it is not unpacked")
    if any(f"{key_of_name(file.path)}/".startswith(f"{key_of_name(manifest.folder)}/") for file in manifest.inputs):
        raise InputError(f"{where}: has inputs in its run folder {manifest.folder!r}; pack the run again")
    if manifest.config not in {file.path for file in manifest.inputs}:
        raise InputError(
            f"{where}: its configuration {manifest.config!r} is not among its inputs; pack the run again",
            id="missing-value",
        )
    return manifest


def check_names(manifest: Manifest, where: str, so: str) -> None:
    """Raise InputError for invalid names in a manifest, or two that some systems treat as one.

    Args:
        manifest: the manifest.
        where: name of the archive or folder in messages.
        so: end of the messages, the consequence or remedy.
    """
    for folder, files in ((INPUTS, manifest.inputs), (OUTPUTS, manifest.outputs)):
        met: dict[str, str] = {}
        for file in files:
            check_name(f"{folder}/{file.path}", where, so)
            key = key_of_name(file.path)
            if key in met:
                both = f"{met[key]!r} and {file.path!r}"
                raise InputError(
                    f"{where}: names a file twice where case does not count, {both}; {so}", id="duplicate-name"
                )
            met[key] = file.path
    check_name(manifest.folder, where, so)


def key_of_name(name: str) -> str:
    """Return a key that is equal for names some systems treat as equal, by case and by encoding of accents."""
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", name).casefold())


def check_name(name: str, where: str, so: str) -> None:
    """Raise InputError for a name of a file that leads out of its folder, or that other programs misread.

    Colons are allowed: names of recordings with a time contain them. `where`: archive or folder, begin of the message;
    `so`: its end.
    """
    parts = name.split("/")
    bad = (
        len(name) > LONGEST_NAME or any(part in ("", ".", "..") for part in parts) or PurePosixPath(name).is_absolute()
    )
    if bad or "\\" in name or not name.isprintable():
        raise InputError(f"{where}: {name[:80]!r} is no name of a file inside the archive; {so}")


def lock_text(manifest: Manifest) -> bytes:
    """Return the exact package versions in pip's format, Python's in a comment."""
    packages = {name: version for name, version in manifest.versions.items() if name != "python"}
    lines = [f"# Python {manifest.versions.get('python', '?')}", f"occlog=={manifest.version}"]
    return "\n".join([*lines, *(f"{name}=={version}" for name, version in sorted(packages.items())), ""]).encode()


FREE_BYTES, MAX_GROWTH = 1 << 30, 4
"""Unpacked bytes that any archive may hold, and above that for each of its bytes: only texts are compressed."""
MAX_FILES = 10_000
TEXTS = (".json", ".yaml", ".yml", ".txt", ".csv", ".html", ".xml", ".toml", ".svg")
_TIME = (1980, 1, 1, 0, 0, 0)
_PART = 1 << 20
_ENCRYPTED = 1
FAILURES = (
    zipfile.BadZipFile,
    zlib.error,
    ValueError,
    EOFError,
    OSError,
    NotImplementedError,
    RuntimeError,
    LookupError,
)
"""Exceptions of the library for damaged archives."""


class Packer:
    """Writer of a reproducible zip archive into an open file."""

    def __init__(self, file: IO[bytes]) -> None:
        """Create an empty archive in an open binary file."""
        self._zip = zipfile.ZipFile(file, "w")
        self._compressed = 0

    def bytes(self, name: str, data: bytes) -> None:
        """Add the file `name` with the content `data`."""
        self._zip.writestr(_info(name), data, compresslevel=6)

    def file(self, name: str, path: Path, entry: PackedFile) -> None:
        """Add the file at `path` under `name`.

        `entry`: its size and SHA-256 when it was checked; InputError if it has changed.
        """
        digest = hashlib.sha256()
        info = _info(name)
        info.file_size = entry.bytes
        if info.compress_type == zipfile.ZIP_DEFLATED:
            self._compressed += entry.bytes
            if self._compressed > FREE_BYTES // 2:  # more of it might not be unpacked again
                info.compress_type = zipfile.ZIP_STORED
        with path.open("rb") as source, self._zip.open(info, "w", force_zip64=entry.bytes > zipfile.ZIP64_LIMIT) as out:
            while part := source.read(_PART):
                digest.update(part)
                out.write(part)
        if digest.hexdigest() != entry.sha256:
            raise InputError(f"{path}: changed while it was packed; pack the run again", id="file-changed")

    def close(self) -> None:
        """Write the archive's index; the file stays open."""
        self._zip.close()


def _info(name: str) -> zipfile.ZipInfo:
    info = zipfile.ZipInfo(name, _TIME)
    info.create_system = 3
    info.external_attr = (stat.S_IFREG | 0o644) << 16
    info.compress_type = zipfile.ZIP_DEFLATED if name.endswith(TEXTS) else zipfile.ZIP_STORED
    return info


@contextmanager
def _guarded(path: Path) -> Iterator[None]:
    try:
        yield
    except FAILURES as error:
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise InputError(
            f"{path}: damaged, or no archive of `occlog pack` ({reason}); copy it again", id="damaged-file"
        ) from error


def unpack(path: Path, folder: Path) -> Manifest:
    """Write the files of an archive into an empty folder; return its manifest.

    Nothing is written but regular files below `folder`, with names, sizes and hashes as in the manifest.

    Args:
        path: the archive.
        folder: an empty folder.

    Raises:
        InputError: it is damaged or hostile: names that lead out, links, more files or bytes than stated or allowed,
            files that the manifest does not have, or that are not what it states.
        OutputError: there is no space for them.
    """
    check_input(path, "an archive of `occlog pack`")
    with _guarded(path):
        archive = zipfile.ZipFile(path)
    with archive:
        members = _members(path, archive)
        with _guarded(path):
            raw = archive.read(members[MANIFEST]) if MANIFEST in members else b""
        manifest = read_manifest(raw, f"{path}: {MANIFEST}")
        wanted = manifest.members()
        for name in sorted({*wanted, MANIFEST, LOCK} ^ set(members)):
            fault = "is missing" if name not in members else f"is not in {MANIFEST}"
            raise InputError(f"{path}: {name} {fault}; nothing was unpacked: copy or pack it again", id="damaged-file")
        with _guarded(path), archive.open(members[LOCK]) as source:
            wanted_lock = lock_text(manifest)
            same = source.read(len(wanted_lock) + 1) == wanted_lock
        if not same:
            raise InputError(
                f"{path}: {LOCK} has other versions than {MANIFEST}; nothing was unpacked: copy or pack it again",
                id="file-changed",
            )
        _check_space(path, members, folder)
        for name, entry in wanted.items():
            with _guarded(path), archive.open(members[name]) as source:
                _copy(source, folder / name, entry, f"{path}: {name}")
    return manifest


def _members(path: Path, archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    """Return the members of an archive by name.

    InputError for one that is no plain file, or if they exceed the limits.
    """
    infos = archive.infolist()
    if len(infos) > MAX_FILES:
        raise InputError(
            f"{path}: {len(infos)} files; the limit is {MAX_FILES}: pack a run with fewer inputs", id="input-too-large"
        )
    found: dict[str, zipfile.ZipInfo] = {}
    for info in infos:
        check_name(info.filename, str(path), "it is not unpacked")
        kind = stat.S_IFMT(info.external_attr >> 16)
        fault = (
            "a link or a device"
            if kind not in (0, stat.S_IFREG)
            else "encrypted"
            if info.flag_bits & _ENCRYPTED
            else "packed in a way that occlog does not pack"
            if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
            else "there twice"
            if key_of_name(info.filename) in found
            else ""
        )
        if fault:
            raise InputError(
                f"{path}: {info.filename}: is {fault}; nothing was unpacked: copy or pack it again", id="damaged-file"
            )
        found[key_of_name(info.filename)] = info
    limit, total = FREE_BYTES + MAX_GROWTH * path.stat().st_size, sum(info.file_size for info in infos)
    if total > limit:
        raise InputError(
            f"{path}: unpacks to {total} bytes; the limit of an archive of its size is {limit}; pack the run again",
            id="input-too-large",
        )
    large = next((i for i in infos if i.filename == MANIFEST and i.file_size > MAX_MANIFEST_BYTES), None)
    if large is not None:
        raise InputError(
            f"{path}: {MANIFEST}: {large.file_size} bytes; the limit is {MAX_MANIFEST_BYTES}; pack the run again",
            id="input-too-large",
        )
    return {info.filename: info for info in infos}


def _check_space(path: Path, members: Mapping[str, zipfile.ZipInfo], folder: Path) -> None:
    total, free = sum(info.file_size for info in members.values()), shutil.disk_usage(folder).free
    if total > free:
        raise OutputError(f"{path}: unpacks to {total} bytes, and {folder} has {free}; free some space, or set TMPDIR")


def _copy(
    source: IO[bytes], target: Path, entry: PackedFile, where: str, remedy: str = "copy the archive again"
) -> None:
    """Write an open file to the new path `target`, and check its size and hash.

    Args:
        source: binary file.
        target: its folders are created.
        entry: expected size and SHA-256; InputError if the content differs.
        where: name of the source in messages.
        remedy: end of the message.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    digest, size = hashlib.sha256(), 0
    with target.open("xb") as out:
        while part := source.read(min(_PART, entry.bytes - size + 1)):
            size += len(part)
            if size > entry.bytes:
                break
            digest.update(part)
            out.write(part)
    if size != entry.bytes or digest.hexdigest() != entry.sha256:
        raise InputError(f"{where}: is not what {MANIFEST} states (size or SHA-256); {remedy}", id="file-changed")


def take(source: Path, target: Path, entry: PackedFile) -> None:
    """Copy an input that is not in the archive to `target`; InputError unless size and SHA-256 are as in `entry`."""
    check_input(source, "an input of the packed run")
    with source.open("rb") as file:
        _copy(file, target, entry, str(source), "give the folder that has the inputs of this run: --inputs FOLDER")
