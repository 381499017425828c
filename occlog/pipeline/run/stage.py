"""Stages of a run: requests from the keys of a configuration, and the files that a stage reads."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

from occlog import console
from occlog.cli.input_paths import standard_input
from occlog.errors import InputError, UsageError, did_you_mean, option
from occlog.io.files.limits import STANDARD_INPUT
from occlog.io.files.texts.by_reader import NamedReader, named_reader
from occlog.io.formats.boxes.datasets import names_of_classes
from occlog.io.formats.models.onnx_file import read_onnx
from occlog.io.recording.reader import linked_videos
from occlog.plugins.loading import READER, Chosen, Plugin, find, installed
from occlog.request import Form, Request, RequestEntry, group
from occlog.runner import exit_code, run
from occlog.settings import (
    SettingError,
    Settings,
    check_setting,
    declaration,
    declared,
    kind_of,
    plain_kind,
    read_pair,
    read_value,
)

READS, SET, STRICT = "reader", "set", "strict"
"""Keys of every request: reader of a plug-in for its inputs, settings without a key, and a verdict as the exit code."""


@dataclass(frozen=True)
class RunStage:
    """A stage of a run: the request of a command, made from the keys of a configuration.

    Attributes:
        name: name of the stage.
        form: fields and settings of the request.
        values: by key, as in the configuration, inputs and outputs included.
        output_paths: those of the values that are paths of outputs.
    """

    name: str
    form: Form
    values: Mapping[str, object]
    output_paths: tuple[str, ...]

    def texts(self) -> list[str]:
        """Return the values of the stage as texts, for its hash and files: each key, then its value or items."""
        return [text for name, value in self.values.items() for text in (f"{name}:", *map(str, listed(value)))]

    def keys(self) -> list[str]:
        """Return the keys that the stage accepts.

        Raises:
            UsageError: a key names a missing plug-in.
        """
        settings = () if self.form.set_group() is None else (SET,)
        strict = (STRICT,) if self.form.request.JUDGED and self.form.request.STRICT else ()
        return [*(entry.key for entry in self._entries()), READS, *settings, *strict]

    def without_key(self, name: str) -> bool:
        """Return whether a name is that of a setting without a key of its own, to be given under `set`."""
        return any(name == f.name for of in self._free() for f in declared(of))

    def check(self) -> None:
        """Parse all values as the request does, without running it.

        Raises:
            UsageError: an invalid value; the message names its key.
        """
        self._chosen_reader()
        self._request()

    def do(self, *, quiet: bool = True) -> int:
        """Run the request without printing its summary; losses are printed. Return the exit code.

        `quiet`: print no notes and no progress.
        """
        with ExitStack() as stack:
            kept = stack.enter_context(standard_input()) if STANDARD_INPUT in self.texts() else None
            request, chosen = self._request(kept), self._chosen_reader()
            reader: NamedReader | None = None if chosen is None else stack.enter_context(named_reader(chosen))
            with self._keys_in_errors():
                done = run(request, overwrite=True, quiet=quiet)
            if reader is not None:
                reader.check_used()
        console.note_losses(done.losses)
        for line in done.failed:
            console.note(f"{option('fail_if')} {line}")
        return exit_code(request, done, strict=self.values.get(STRICT) is True)

    def _request(self, kept: Path | None = None) -> Request:
        """Return the request made from the values; UsageError for an invalid one.

        `kept`: file that replaces standard input (`-`); None: it stays.
        """
        given = {entry.name: self._read(entry, kept) for entry in self.form.entries() if self._has(entry)}
        free, settings = self.form.set_group(), self._settings()
        with self._keys_in_errors():
            for entry in self.form.entries():
                if entry.group is not None and entry.name in given:
                    check_setting([entry.owner], entry.of.name, given[entry.name])
            for name, value in settings.items():
                self._check_free(name, value)
            return self.form.build(given, {} if free is None else {free[0]: settings})

    def _has(self, entry: RequestEntry) -> bool:
        return self.values.get(entry.key) is not None

    def _entries(self) -> Iterator[RequestEntry]:
        """Generate the fields of the request, then the settings of the plug-ins that its values name."""
        own = list(self.form.entries())
        named = [plugin for entry in own if entry.plugged is not None for plugin in self._plugins(entry)]
        if (reader := self._reader()) is not None:
            named.append(reader)
        return chain(own, *(form_of_plugin(plugin).entries() for plugin in named))

    def _plugins(self, entry: RequestEntry) -> list[Plugin]:
        assert entry.plugged is not None
        names = listed(self.values.get(entry.key, ()))
        return [plugin_of(entry.key, str(name), entry.plugged.kind) for name in names]

    def _reader(self) -> Plugin | None:
        name = self.values.get(READS)
        return None if name is None else plugin_of(READS, str(name), READER)

    def _chosen_reader(self) -> Chosen | None:
        plugin = self._reader()
        return None if plugin is None else self._chosen(plugin)

    def _chosen(self, plugin: Plugin) -> Chosen:
        """Return a plug-in with its settings in the configuration."""
        entries = form_of_plugin(plugin).entries()
        return Chosen(plugin, {entry.of.name: self._read(entry) for entry in entries if self._has(entry)})

    def _read(self, entry: RequestEntry, kept: Path | None = None) -> object:
        """Return the value of a key in the type of the request's field; UsageError if it does not fit.

        `kept`: file that replaces standard input (`-`); None: it stays.
        """
        value, of = self.values[entry.key], entry.file
        if entry.plugged is not None:
            return tuple(self._chosen(plugin) for plugin in self._plugins(entry))
        if of is None:
            return setting_of(entry, value)
        if plain_kind(kind_of(entry.owner, entry.of.name)) is not tuple:
            return _file(entry, value, kept)
        items = listed(value)
        if of.together == 1:
            return tuple(_file(entry, item, kept) for item in items)
        flat = [_file(entry, each, kept) for item in items for each in listed(item)]
        return tuple(zip(*(flat[n :: of.together] for n in range(of.together)), strict=True))

    def _settings(self) -> dict[str, str]:
        """Return the settings under the key `set`, as text by name; UsageError unless each is NAME=VALUE."""
        given = self.values.get(SET) or {}
        if isinstance(given, Mapping):
            return {str(name): ",".join(map(str, listed(value))) for name, value in given.items()}
        parts = [str(text).partition("=") for text in listed(given)]
        for name, equals, _ in parts:
            if not equals:
                raise UsageError(f"{option(SET)}: {name}: expected NAME=VALUE")
        return {name.strip(): value for name, _, value in parts}

    def _free(self) -> list[type[Settings]]:
        """Return the settings classes to which the key `set` applies; empty if there are none."""
        free = self.form.set_group()
        return [] if free is None else [self.form.classes()[free[0]], *self.form.around]

    def _check_free(self, name: str, value: str) -> None:
        try:
            check_setting(self._free(), name, value)
        except UsageError as error:
            key = option(f"set.{name}" if name.isidentifier() else SET)
            raise UsageError(f"{key}: {str(error).removeprefix(f'setting {name}: ')}") from error

    @contextmanager
    def _keys_in_errors(self) -> Iterator[None]:
        """Context manager that puts the key of the configuration into errors of a setting.

        Other errors are unchanged.
        """
        try:
            yield
        except SettingError as error:
            for entry in self.form.entries():
                if (entry.owner.OWNER, entry.of.name) == (error.owner, error.setting) and self._has(entry):
                    typed = ",".join(map(str, listed(self.values[entry.key])))
                    raise UsageError(f"{option(entry.key)}: {typed}: must be {error.limit}") from error
            if error.setting in (settings := self._settings()):
                where = option(f"set.{error.setting}")
                raise UsageError(f"{where}: {settings[error.setting]}: must be {error.limit}") from error
            raise UsageError(f"{option(error.setting)}: {error}") from error


@dataclass(frozen=True, kw_only=True)
class _Plugged(Request):
    """Request that consists of the settings of a plug-in alone, to parse them."""

    own: Mapping[str, object] = group(None)


def form_of_plugin(plugin: Plugin) -> Form:
    """Return the form of a plug-in's settings, with which their keys are parsed."""
    return Form(_Plugged, settings={"own": plugin.load().settings}, under={"own": plugin.name})


def plugin_of(key: str, name: str, kind: str) -> Plugin:
    """Return the plug-in of a name and kind; UsageError, with the most similar name, if missing.

    `key`: of the configuration that names it, for the message.
    """
    plugin = find(name, kind)
    if plugin is None:
        known = did_you_mean(name, (each.name for each in installed(kind)))
        raise UsageError(f"{option(key)}: {name!r}: no such {kind}; {known}", id="unknown-key")
    return plugin


def setting_of(entry: RequestEntry, value: object) -> object:
    """Return the YAML value of a setting in its type and own unit; UsageError, which names the key, if invalid."""
    spec, kind = declaration(entry.of), kind_of(entry.owner, entry.of.name)
    if plain_kind(kind) is bool:
        if not isinstance(value, bool):
            raise UsageError(f"{option(entry.key)}: expected true or false, got {value!r}")
        return value
    texts = [str(each) for each in listed(value)]
    if spec.whole:
        return tuple(texts)
    try:
        if spec.frames or spec.size:
            return read_pair(("x" if spec.size else ":").join(texts), spec.size)
        found: Any = read_value(",".join(texts), kind, entry.key)
    except UsageError as error:
        raise UsageError(f"{option(entry.key)}: {str(error).removeprefix(f'setting {entry.key}: ')}") from error
    return found if spec.scale == 1.0 or found is None else found * spec.scale


def _file(entry: RequestEntry, value: object, kept: Path | None) -> float | Path:
    """Return the path that a value names, or the number that the field accepts instead.

    Args:
        entry: field of the request.
        value: value of its key.
        kept: file that replaces standard input (`-`); None: it stays.
    """
    text = ",".join(map(str, listed(value)))
    if kept is not None and text == STANDARD_INPUT:
        return kept
    assert entry.file is not None
    if entry.file.number is None:
        return Path(text)
    try:
        number = float(text)
    except ValueError:
        return Path(text)
    if not number >= entry.file.number:
        raise UsageError(f"{option(entry.key)}: {text}: must be at least {entry.file.number:g}")
    return number


def listed(value: object) -> list[object]:
    """Return the items of a value as a list: texts `key=value` for a mapping, one item for a single value."""
    if isinstance(value, Mapping):
        return [f"{k}={v}" for k, v in value.items()]
    return list(value) if isinstance(value, list | tuple) else [value]


NETWORK = ".onnx"


def places_of(argument: str) -> list[Path]:
    """Return the existing paths that a text may mean: the whole of it, and the part after `NAME=`."""
    texts = dict.fromkeys((argument, argument.split("=", 1)[-1]))
    # A title may be longer than any name of a file, of which Path.exists would complain
    return [Path(text) for text in texts if text and os.path.exists(text)]  # noqa: PTH110


def files_of(argument: str) -> list[Path]:
    """Return the files that a text names, with files that are read along with them.

    Of a folder these are all its files. Files read along are the linked videos of a recording, the weights of a
    network, and the class names of a folder with labels.
    """
    found: dict[Path, None] = {}
    for path in places_of(argument):
        found |= dict.fromkeys([path] if path.is_file() else sorted(path.rglob("*")))
        found |= dict.fromkeys(_beside(path))
    return [file for file in found if file.is_file()]


def _beside(path: Path) -> Iterator[Path]:
    if path.is_dir():
        for folder in (path, *sorted(each for each in path.rglob("*") if each.is_dir())):
            names = names_of_classes(folder)
            if names is not None:
                yield names
    elif path.suffix.lower() == NETWORK and path.is_file():
        try:
            yield from read_onnx(path).weights
        except InputError:  # whoever reads it states it
            return
    elif path.is_file():
        yield from linked_videos(path)


def name_of(file: Path, argument: str) -> str:
    """Return the key of a file in `files_of`, independent of its location: its name, in a folder its relative path.

    `argument`: value of the configuration that names the file or the folder.
    """
    folders = (path for path in places_of(argument) if path.is_dir() and file.is_relative_to(path))
    return next((file.relative_to(path).as_posix() for path in folders), file.name)
