"""Calls of API functions: arguments are converted to a request, which the runner executes.

Settings are keyword arguments, found by name and checked as on the command line.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeAlias, TypeVar

import numpy as np

from occlog import console
from occlog.cli.setting_options import wanted
from occlog.errors import UsageError, did_you_mean
from occlog.plugins.loading import Chosen
from occlog.request import File, Form, Request, RequestEntry, Verb
from occlog.runner import run
from occlog.settings import Settings, declaration, kind_of, plain_kind
from occlog.settings import item_kind as kind_of_items

from .folders import Folder
from .recordings import CallInputs, Recording, path_of
from .results import Result, sentences, tables_in, warn

Setting: TypeAlias = float | int | str | bool | Sequence[float] | Sequence[str] | None
"""Value of a setting; a text is read as on the command line."""


def settings_by_class(
    verb: str,
    keywords: Mapping[str, Setting],
    classes: Sequence[tuple[str, type[Settings]]],
    arguments: Collection[str],
) -> list[dict[str, object]]:
    """Distribute keyword arguments to the settings classes that declare them.

    A keyword that several classes declare is set in all of them. Return a dict of settings by name for each class.

    Args:
        verb: command or method, for messages.
        keywords: values of settings by name.
        classes: (prefix, settings class); the prefix comes before the names of its settings in `keywords`, and is
            mostly empty.
        arguments: names of the function's other arguments, as suggestions in messages.

    Raises:
        UsageError: no class declares the setting; the message has the nearest name.
    """
    names = [{begin + f.name: f.name for f in fields(of)} for begin, of in classes]
    known = sorted(set().union(*names))
    for name in keywords:
        if name not in known:
            hint = did_you_mean(name, [*arguments, *known], "it has:", owner=verb)
            raise UsageError(f"{verb} has no setting {name!r}; {hint}", id="unknown-key")
    return [
        {own[name]: declared_value(of, own[name], value) for name, value in keywords.items() if name in own}
        for own, (_, of) in zip(names, classes, strict=True)
    ]


def declared_value(of: type[Settings], name: str, value: object) -> object:
    """Return a value of a Python argument in the declared type of a setting, without checking it.

    An int becomes a float where floats are declared, a sequence a tuple, a NumPy scalar a Python number, and a sequence
    of texts one text with commas. Texts and None are returned as they are.

    Args:
        of: settings class that declares the setting.
        name: name of the setting.
        value: value of the argument.
    """
    kind = kind_of(of, name)
    plain = plain_kind(kind)
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, str) or value is None:
        return value
    if isinstance(value, Iterable):
        items = [v.item() if isinstance(v, np.generic) else v for v in value]
        if plain is str:
            return ",".join(str(v) for v in items)
        floats = kind_of_items(kind) == (tuple, float)
        return tuple(float(v) if floats and isinstance(v, int) and not isinstance(v, bool) else v for v in items)
    if plain is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    return value


def names_of(value: str | Sequence[str]) -> tuple[str, ...]:
    """Return the sensor names in an argument: one text, several separated by commas, or a sequence of such texts."""
    return tuple(part.strip() for text in _items(value) for part in str(text).split(",") if part.strip())


def _items(value: object) -> list[Any]:
    """Return the items of a sequence; a text, and what is no sequence, is one item."""
    return [value] if isinstance(value, str) or not isinstance(value, Iterable) else list(value)


R = TypeVar("R", bound=Result)


def call(
    form: Form,
    arguments: Mapping[str, Any],
    result: type[R],
    called: Mapping[str, str] | None = None,
    **more: Callable[[Request], object],
) -> R:
    """Execute the request of an API function, and return its result.

    Findings and losses are also issued as Python warnings.

    Args:
        form: form of the request.
        arguments: arguments of the function by name: fields of the request; groups of settings that are one argument;
            `settings` (keyword arguments); `also` (names of optional tables); paths of outputs; `overwrite` and
            `progress`.
        result: class of the return value.
        called: names of inputs in messages by field name (`field[0]` for one of several files), where the two differ.
        more: functions from the request to further attributes of the result, by name; they are called while the
            temporary input files still exist.

    Raises:
        UsageError: an unknown setting, or arguments that contradict each other.
        InputError: an input is missing, damaged, or impossible.
    """
    home = Folder()
    arguments_of = {entry.key: entry.field if entry.group is None else entry.of.name for entry in form.entries()}
    with CallInputs(arguments_of) as inputs, console.notes_kept() as notes:
        outputs = _outputs(form, arguments, home)
        plain = (entry for entry in form.entries() if entry.group is None)
        given = {entry.name: _value(entry, arguments, inputs, called or {}) for entry in plain}
        request = form.build({**given, **outputs}, _groups(form, arguments))
        request = _fitting(request, outputs)
        done = run(request, overwrite=arguments.get("overwrite", False), quiet=not arguments.get("progress", False))
        found = {name: of(request) for name, of in more.items()}
        note = [inputs.named(text) for text in notes]
    warnings, notes_left = sentences(note)
    losses = tuple(dict.fromkeys((*done.earlier, *done.losses)))
    warn(warnings, losses)
    tables = tables_in(home, [path.stem for path in outputs.values()])
    return result(home.without_paths(done.summary), tables, losses, warnings, notes_left, **found)


def record(form: Form, arguments: Mapping[str, Any]) -> Recording:
    """Execute a request that makes a recording, and return the recording; its `summary` includes the `notes`.

    Args:
        form: form of the request.
        arguments: arguments as for `call`, with `output`: path of the recording, or None for a temporary folder, which
            is removed with the last reference to the recording.

    Raises:
        OutputExistsError: the output exists and may not be replaced.
    """
    home, output = Folder(), arguments["output"]
    path = home.file("recording.mcap") if output is None else path_of(output, "output")
    arguments_of = {entry.key: entry.field if entry.group is None else entry.of.name for entry in form.entries()}
    with CallInputs(arguments_of) as inputs, console.notes_kept() as notes:
        plain = (entry for entry in form.entries() if entry.group is None)
        given = {entry.name: _value(entry, arguments, inputs, {}) for entry in plain}
        request = form.build({**given, "output": path}, _groups(form, arguments))
        done = run(request, overwrite=arguments["overwrite"], quiet=not arguments["progress"])
        warnings, notes_left = sentences(inputs.named(text) for text in notes)
    warn(warnings, done.losses)
    summary = home.without_paths(done.summary) if output is None else done.summary
    return Recording(path, {**summary, "notes": notes_left}, None if output is not None else home)


def check_taken(
    form: Form,
    given: Mapping[str, object],
    also: Sequence[str],
    called: str,
    verb: Verb | None = None,
    settings: Mapping[str, object] = MappingProxyType({}),
) -> None:
    """Raise UsageError for an argument or an optional table that the chosen form of a request does not have.

    Args:
        form: chosen form of the request.
        given: arguments that some forms lack, by name; None, False and () count as not given.
        also: names of the tables requested by the argument `also`.
        called: words for the form in messages.
        verb: the command's other kinds of requests, which are suggested where they have the argument.
        settings: keyword arguments; those that no kind has are not checked here.
    """
    entries = list(form.entries())
    taken = _arguments_of(form)
    kinds = {} if verb is None else {name: _arguments_of(kind.form()) for name, kind in verb.kinds.items()}
    for name, value in {**settings, **given}.items():
        if value is None or value is False or (isinstance(value, tuple) and not value) or name in taken:
            continue
        owners = [kind for kind, names in kinds.items() if name in names]
        if owners or name in given:
            hint = f", or choose one that has it: {', '.join(owners)}" if owners else ""
            raise UsageError(f"{name} is not an argument of {called}; leave it out{hint}", id="not-applicable")
    tables = [entry.field for entry in entries if entry.file is not None and entry.file.asked == "also"]
    for name in names_of(also):
        if name not in tables:
            known = ", ".join(tables) or "none"
            raise UsageError(f"also: {called} has no table {name!r} on request; it has: {known}", id="unknown-name")


def _arguments_of(form: Form) -> set[str]:
    """Return the names of a form's fields and of its settings that have an option of their own."""
    return {name for entry in form.entries() for name in (entry.field, entry.of.name)}


def _outputs(form: Form, arguments: Mapping[str, Any], home: Folder) -> dict[str, Path]:
    """Return the paths of the requested output files, by entry of the request.

    Args:
        form: form of the request.
        arguments: arguments of the call; an output is requested by a path, or by True for a temporary file.
        home: folder of temporary files.
    """
    found = {}
    for entry in form.entries():
        of = entry.file
        if of is not None and of.output and _asked(entry, of, arguments):
            given, called = arguments.get(entry.field), of.result or (of.table if entry.required else entry.field)
            own = Path(given) if isinstance(given, str | os.PathLike) else None
            found[entry.name] = home.file(f"{called}{of.suffix}") if own is None else own
    return found


def _fitting(request: Request, outputs: Mapping[str, Path]) -> Request:
    """Return a copy of the request without those default outputs that do not apply to its kind of input.

    `outputs`: paths of all outputs, by entry of the request.
    """
    unfit = (entry for entry in request.unfit(request.kind_of_input()) if entry.name in outputs)
    return replace(request, **{entry.field: None for entry in unfit if entry.file and entry.file.asked == "always"})


def _asked(entry: RequestEntry, of: File, arguments: Mapping[str, Any]) -> bool:
    if of.asked == "also":
        return entry.field in names_of(arguments.get("also", ()))
    value = arguments.get(of.asked)
    return of.asked == "always" or not (value is None or value is False)


def _value(entry: RequestEntry, arguments: Mapping[str, Any], inputs: CallInputs, called: Mapping[str, str]) -> object:
    """Return an argument of a call in the type of the request's field.

    None if it is not given, or if it names an output.

    Args:
        entry: the field or setting.
        arguments: arguments of the call, by name.
        inputs: writes tables in memory to temporary files, which the request can name.
        called: names of inputs in messages by field name, where the two differ.
    """
    value, of, name = arguments.get(entry.field), entry.file, entry.field
    if value is None or (of is not None and of.output):
        return None
    if (plugged := entry.plugged) is not None:
        return _plugged(value, plugged.kind, name)
    if of is None:
        kind = kind_of(entry.owner, entry.of.name)
        if kind == tuple[str, ...]:
            whole = declaration(entry.of).whole
            return tuple(_text(each) for each in _items(value)) if whole else names_of(value)
        return declared_value(entry.owner, entry.of.name, value)
    if of.scene:
        return inputs.scene(value)
    if of.number is not None and isinstance(value, int | float):
        return float(value)
    if isinstance(value, Sequence) and not isinstance(value, str | bytes):
        if plain_kind(kind_of(entry.owner, entry.of.name)) is not tuple:
            raise UsageError(f"{name}: takes one input; a {type(value).__name__} was given", id="wrong-content")
        names = (f"{name}[{n}]" for n in range(len(value)))
        return tuple(_named(inputs, each, called.get(key, key)) for each, key in zip(value, names, strict=True))
    return _named(inputs, value, called[name]) if name in called else inputs.rows(value, name)


def _plugged(value: Sequence[str] | Mapping[str, Mapping[str, Any]], kind: str, name: str) -> tuple[Chosen, ...]:
    """Return the selected plug-ins of one kind, with their settings.

    Args:
        value: names of plug-ins, or settings by name of plug-in.
        kind: kind of plug-in, for example `metric`.
        name: name of the argument, for messages.

    Raises:
        UsageError: no such plug-in, or an unknown setting.
    """
    given = value if isinstance(value, Mapping) else {each: {} for each in names_of(value)}
    found = []
    for each, values in given.items():
        plugin = wanted(each, kind, name)
        (config,) = settings_by_class(f"{kind} {each}", dict(values), [("", plugin.load().settings)], ())
        found.append(Chosen(plugin, config))
    return tuple(found)


def _text(value: object) -> str:
    """Return a value as typed on the command line; items of a sequence are separated by commas."""
    return ",".join(map(str, value)) if isinstance(value, Iterable) and not isinstance(value, str) else str(value)


def _named(inputs: CallInputs, value: Any, name: str) -> Path:
    """Return the path of a file with an input's rows; a temporary file is called `name` in messages."""
    path = inputs.rows(value, name)
    return path if isinstance(value, str | os.PathLike) else inputs.called(path, name)


def _groups(form: Form, arguments: Mapping[str, Any]) -> dict[str, dict[str, object]]:
    """Return the given settings of a request: for each group (a field of the request) the values by setting.

    Args:
        form: form of the request.
        arguments: arguments of the call. A group is one argument (a mapping of its settings, or True for its defaults),
            or its settings are keyword arguments in `settings`, with the prefix of the group.
    """
    classes = form.classes()
    nested = {name for name in classes if name in arguments and name != "settings"}
    names = [entry.field for entry in form.entries() if entry.group is None]
    found = {}
    for name in nested:
        value = arguments[name]
        if value is not None and value is not False:
            if value is not True and not isinstance(value, Mapping):
                raise UsageError(f"{name}: {value!r}: expected settings by name, or True", id="invalid-setting")
            chosen = settings_by_class(name, {} if value is True else value, [("", classes[name])], ())
            found[name] = chosen[0]
    groups = {f.name: f.metadata["group"] for f in fields(form.request) if "group" in f.metadata}
    flat: list[tuple[str, type[Settings]]] = [(name, of) for name, of in classes.items() if name not in nested]
    free = form.set_group()
    own = form.request.OWNER  # the settings of a plug-in may have no name
    owner = own if free is None else getattr(classes[free[0]], "OWNER", own)
    chosen = settings_by_class(
        owner, arguments.get("settings", {}), [(groups[name].prefix, of) for name, of in flat], names
    )
    return found | {name: values for (name, _), values in zip(flat, chosen, strict=True) if values}
