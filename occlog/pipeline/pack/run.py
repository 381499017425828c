"""`occlog pack`: archive an up-to-date run folder with all its inputs."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from occlog import __version__
from occlog.errors import InputError, UsageError, option
from occlog.io.files.atomic import open_output
from occlog.io.files.provenance import hash_file, installed_versions, processor_type
from occlog.pipeline.run.run import STATE, do_stages, inside, other_versions, outcomes
from occlog.pipeline.run.stage import files_of, places_of
from occlog.pipeline.run.stages import Config, plan, read_config

from .archive import (
    INPUTS,
    LOCK,
    MADE,
    MANIFEST,
    MAX_FILES,
    OUTPUTS,
    Manifest,
    PackedFile,
    Packer,
    check_names,
    lock_text,
    manifest_bytes,
)


class Packed(NamedTuple):
    """Result of packing: manifest, and size of the archive in bytes."""

    manifest: Manifest
    size: int  # of the archive [bytes]


def pack_run(folder: Path, config: Path, output: Path, *, include: bool, overwrite: bool) -> Packed:
    """Write the archive of a run folder, atomically; return its manifest and size.

    Args:
        folder: run folder, in which every stage must be up to date with `config`.
        config: configuration of the run, with relative paths.
        output: the archive to write.
        include: whether the inputs are in the archive, or only their hashes.
        overwrite: replace an existing file.

    Raises:
        UsageError: `folder` is not a run folder.
        InputError: a stage is not up to date, a path in the configuration is absolute, or `verify` would not accept the
            archive: for a name of a file, or for their number.
    """
    if not (folder / STATE).is_file():
        raise UsageError(
            f"{folder}: has no {STATE}, so it is not a run folder; make one: occlog run {config} -o FOLDER",
            id="wrong-content",
        )
    wanted = read_config(config)
    _check_relative(wanted)
    steps = list(do_stages(wanted, folder, force=False, dry_run=True, begin=lambda _: None))
    for step in steps:
        if step.what != "up to date":
            remedy = f"occlog run {config} -o {folder}"
            others = other_versions(folder)
            why = f" (it was made with other packages: {others})" if others else ""
            raise InputError(
                f"{folder}: stage {step.stage} is not up to date with {config}{why}; do it again: {remedy}",
                id="file-changed",
            )
    files = inputs_of(wanted, folder)
    path = folder.resolve()
    parents = [str(file.parent) for file in files] + ([str(path.parent)] if "ingest" in wanted.values else [])
    root = Path(os.path.commonpath(parents))
    stages = {step.stage for step in steps}
    done = {name: outcome for name, outcome in outcomes(folder).items() if name in stages}
    made = sorted({name for outcome in done.values() for name in outcome.outputs})
    manifest = Manifest(
        occlog_pack=1,
        version=__version__,
        versions=installed_versions(),
        config=_name(files[0], root),
        folder=_name(path, root) if "ingest" in wanted.values else MADE,
        inputs=[
            _packed(file, root, include or number == 0)
            for number, file in sorted(enumerate(files), key=lambda each: each[1])
        ],
        outputs=[_packed(folder / name, folder, True) for name in made],
        stages={name: int(outcome.code) for name, outcome in done.items()},
        processor=processor_type(),
    )
    _check_unpackable(manifest, folder)
    with open_output(output, overwrite) as out:
        packer = Packer(out)
        packer.bytes(MANIFEST, manifest_bytes(manifest))
        packer.bytes(LOCK, lock_text(manifest))
        for entry in manifest.inputs:
            if entry.included:
                packer.file(f"{INPUTS}/{entry.path}", root / entry.path, entry)
        for entry in manifest.outputs:
            packer.file(f"{OUTPUTS}/{entry.path}", folder / entry.path, entry)
        packer.close()
        size = out.tell()
    return Packed(manifest, size)


def inputs_of(config: Config, folder: Path) -> list[Path]:
    """Return absolute paths of the configuration, and of the files that its stages read and none makes.

    `folder`: run folder; files in it are omitted.
    """
    path = config.path.parent.resolve() / config.path.name
    found, own = {path: None}, folder.resolve()
    for stage in plan(config, own):
        with inside(path.parent):
            for text in stage.texts():
                if text in stage.output_paths:
                    continue
                for file in files_of(text):
                    location = Path(os.path.abspath(file))  # noqa: PTH100 -- links keep their names
                    if own not in location.resolve().parents:
                        found[location] = None
    return list(found)


def _check_relative(config: Config) -> None:
    """Raise InputError for an absolute path in the configuration, which differs on another machine."""
    for text in _texts(config.values):
        if any(path.is_absolute() for path in places_of(text)):
            raise InputError(
                f"{config.path}: {text}: an absolute path, which another machine does not have; name it relative to "
                "the configuration, run again, and pack"
            )


def _check_unpackable(manifest: Manifest, folder: Path) -> None:
    """Raise InputError for names, or a number of files, that `unpack` would refuse; `folder`: the run, for messages."""
    check_names(manifest, str(folder), "rename it, run again, and pack")
    count = len({*manifest.members(), MANIFEST, LOCK})
    if count > MAX_FILES:
        raise InputError(
            f"{folder}: {count} files with its inputs; the limit is {MAX_FILES}; leave them out: {option('reference')}",
            id="input-too-large",
        )


def _texts(value: object) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for each in value.values():
            yield from _texts(each)
    elif isinstance(value, list):
        for each in value:
            yield from _texts(each)


def _name(file: Path, root: Path) -> str:
    return file.relative_to(root).as_posix()


def _packed(file: Path, root: Path, included: bool) -> PackedFile:
    return PackedFile(_name(file, root), hash_file(file), file.stat().st_size, included)
