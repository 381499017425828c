"""`occlog verify`: repeat a packed run from its inputs, and compare it file by file."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import click

from occlog import __version__
from occlog.console.text import counted
from occlog.errors import ExitCode, InputError, OcclogError, UsageError
from occlog.examine.diff.result import DiffResult, DiffSettings, Tolerances
from occlog.examine.diff.run import compare_files, stage_order
from occlog.io.files.atomic import outputs_below
from occlog.io.files.provenance import hash_file, installed_versions, processor_type
from occlog.pipeline.pack.archive import INPUTS, OUTPUTS, Manifest, take, unpack
from occlog.pipeline.run.run import StageStep, do_stages, inside
from occlog.pipeline.run.stage import files_of, places_of
from occlog.pipeline.run.stages import check_settings, plan, read_config

PROCESSOR = "processor"
"""Name of the type of processor among the versions."""
PYTHON, MAX_NAMED = "python", 2
"""Name of Python among the versions, and how many of those that differ are named in the conclusion."""


class Verified(NamedTuple):
    """Result of verifying a packed run.

    Attributes:
        same: names of outputs with the same bytes.
        similar: names of outputs with other bytes and the same values.
        different: description of the first difference of each other output, by name.
        versions: packages (and `processor`) that differ: version when the run was packed, and now; None: missing.
    """

    same: tuple[str, ...]
    similar: tuple[str, ...]
    different: dict[str, str]
    versions: dict[str, tuple[str | None, str | None]]

    @property
    def code(self) -> ExitCode:
        """Exit code: 0 if all is equal (with other versions, equal values suffice), else 5."""
        explained = not self.similar or bool(self.versions)
        return ExitCode.DONE if explained and not self.different else ExitCode.DIFFERENT

    def in_words(self) -> str:
        """Return the conclusion as a sentence: what differs, why, and the remedy."""
        if not self.similar and not self.different:
            return "made again to the same bytes"
        if not self.versions:
            return "versions and processor are the same, so that they do not explain what differs"
        if set(self.versions) == {PROCESSOR}:
            then, now = self.versions[PROCESSOR]
            cause, remedy = f"another processor ({then}, now {now})", "verify on one of its type"
        else:
            cause, remedy = _in_words(self.versions), "install those of lock.txt, and verify again"
        if not self.different:
            return f"the same values; {cause}, so that bytes differ"
        return f"{cause}: may explain what differs; {remedy}"


def _in_words(versions: dict[str, tuple[str | None, str | None]]) -> str:
    """Return, in words, which versions differ: at most `MAX_NAMED`, Python's first, those of missing packages last.

    `versions`: as in `Verified`.
    """
    names = sorted(versions, key=lambda name: (name != PYTHON, None in versions[name], name))
    found = [f"{name} {then or 'none'}, now {now or 'none'}" for name in names for then, now in [versions[name]]]
    more = f"; and {len(found) - MAX_NAMED} more" if len(found) > MAX_NAMED else ""
    return f"other versions ({'; '.join(found[:MAX_NAMED])}{more})"


def verify_pack(archive: Path, inputs: Path | None, begin: Callable[[str], None]) -> Verified:
    """Repeat a packed run in a temporary folder, and compare all outputs.

    Args:
        archive: written by `occlog pack`.
        inputs: folder with the inputs that are not in the archive, under their names in it; None: none.
        begin: called with the name of each stage before it runs.

    Raises:
        InputError: the archive is damaged, names files outside of itself, or a stage fails.
        UsageError: inputs are not in the archive, and no folder is given.
    """
    with tempfile.TemporaryDirectory(prefix="occlog-verify-") as name:
        folder = Path(name).resolve()
        manifest = unpack(archive, folder)
        _add_inputs(archive, manifest, inputs, folder / INPUTS)
        made = folder / INPUTS / manifest.folder
        try:
            with outputs_below(folder / INPUTS):
                steps = _make_again(manifest, folder, made, begin)
        except (OcclogError, click.ClickException) as error:
            reason = str(error).replace(f"{folder}/", "")
            raise InputError(f"{archive}: its run cannot be repeated: {reason}") from error
        found = _compare(manifest, folder / OUTPUTS, made)
    for name in sorted({name for step in steps for name in step.outputs} - {file.path for file in manifest.outputs}):
        found.different[name] = "was made, and is not in the archive"
    codes = {step.stage: int(step.code) for step in steps}
    for stage in {**manifest.stages, **codes}:
        then, now = (each.get(stage, "nothing") for each in (manifest.stages, codes))
        if then != now:
            found.different[f"stage {stage}"] = f"ended with {then}, now with {now}"
    return found


def _add_inputs(archive: Path, manifest: Manifest, inputs: Path | None, folder: Path) -> None:
    """Copy the inputs that the archive only references from `inputs` to `folder`.

    UsageError if some are needed and `inputs` is None.
    """
    for file in manifest.inputs:
        if not file.included:
            if inputs is None:
                raise UsageError(
                    f"{archive}: {file.path} is not in it; give the folder of its inputs: --inputs FOLDER",
                    id="unknown-name",
                )
            take(inputs / file.path, folder / file.path, file)


def _make_again(manifest: Manifest, folder: Path, made: Path, begin: Callable[[str], None]) -> list[StageStep]:
    """Run all stages of the unpacked archive, and return a report on each.

    InputError for a configuration with files outside of the archive, or inputs that no stage uses.

    Args:
        manifest: manifest of the archive.
        folder: where it was unpacked.
        made: run folder to write.
        begin: called with the name of a stage before it runs.
    """
    config = read_config(folder / INPUTS / manifest.config)
    unused = {(folder / INPUTS / file.path).resolve() for file in manifest.inputs} - {config.path.resolve()}
    for stage in plan(config, made):
        check_settings(config, stage)
        with inside(config.path.parent):
            for text in stage.texts():
                named = (*places_of(text), *files_of(text))
                outside = [p for p in named if folder not in p.resolve().parents]
                if outside:
                    raise InputError(
                        f"stage {stage.name} uses {outside[0]}, which is not in the archive; pack the run again",
                        id="missing-value",
                    )
                unused -= {path.resolve() for path in named}
    if unused:
        first = min(unused).relative_to(folder / INPUTS)
        raise InputError(
            f"no stage uses {counted(len(unused), 'input')} of the archive, such as {first}; pack the run again",
            id="incompatible-inputs",
        )
    return list(do_stages(config, made, force=False, dry_run=False, begin=begin))


def _compare(manifest: Manifest, packed: Path, made: Path) -> Verified:
    declared = {file.path: file for file in manifest.outputs}
    same, similar, different = [], [], {}
    for name in stage_order(declared):
        old, new = packed / name, made / name
        if not new.is_file():
            different[name] = "was not made"
        elif hash_file(new) == declared[name].sha256:
            same.append(name)
        else:
            parts = [part for part in compare_files(old, new, name, DiffSettings(Tolerances())) if not part.same]
            if parts:
                different[name] = _first(parts[0])
            else:
                similar.append(name)
    now, then = {"occlog": __version__, **installed_versions()}, {"occlog": manifest.version, **manifest.versions}
    if manifest.processor:
        now[PROCESSOR], then[PROCESSOR] = processor_type(), manifest.processor
    names = sorted({*now, *then})
    versions = {n: (then.get(n), now.get(n)) for n in names if then.get(n) != now.get(n)}
    return Verified(tuple(same), tuple(similar), different, versions)


def _first(part: DiffResult) -> str:
    """Return the description of the first difference of two files."""
    first = part.first or part.schema[0]
    values = f": {first.a} is now {first.b}" if first.a is not None or first.b is not None else ""
    return f"{first.kind} {first.location}{values}" + (f" ({first.column})" if first.column else "")
