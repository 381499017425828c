"""Requests of commands: each is declared once, and its options, Python arguments and YAML keys are made from that.

A class of requests derives from `Request`. Its fields are files to read (`source`) and to write (`sink`), values
(`occlog.settings.setting`) and groups of settings (`group`). A field has one name, which is its key in YAML; the
command line spells it `--fused-views`, Python `fused_views`. Where the option of a field has another name, that is the
key everywhere.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, TypeVar

from occlog.errors import UsageError, did_you_mean, option
from occlog.settings import Declaration, Settings, declaration, declared, kind_of, read_value, setting

S = TypeVar("S", bound=Settings)
SCENE_HELP = "Scene file (YAML), a recording that contains one, or a text table of sensor positions (name, x, y)."


@dataclass(frozen=True)
class File:
    """Declaration of a request's field that names one or several files.

    Attributes:
        help: help text, one or more sentences.
        output: the file is written; otherwise it is read.
        table: of outputs: name of the table in the file; empty: it contains none, or the command decides.
        result: of outputs: name in the result of the Python function; empty: that of the field, or of the table in the
            main output.
        asked: of outputs: when the Python function makes it: `always`, `also` (if named in the argument `also`),
            `never`, or if the argument of that name is given.
        option: option as click declares it (`-o/--output`); None: made from the field's name.
        metavar: placeholder for the option's value in the help.
        argument: it is a positional argument.
        together: of fields of several files: number of files that are given at a time.
        number: least number that may be given in place of the file; None: only a file.
        scene: a scene is read from the file.
        there: click checks that the file exists, and `-` is standard input.
        kinds: kinds of input that the file applies to, for requests with several (`Request.KIND`); empty: all.
        suffix: of outputs: end of the file's name where the Python function chooses it.
    """

    help: str
    output: bool = False
    table: str = ""
    result: str = ""
    asked: str = "always"
    option: str | None = None
    metavar: str | None = None
    argument: bool = False
    together: int = 1
    number: float | None = None
    scene: bool = False
    there: bool = True
    kinds: tuple[str, ...] = ()
    suffix: str = ".parquet"


@dataclass(frozen=True)
class SettingsGroup:
    """Declaration of a request's field that contains the given settings of a settings class, by name.

    Attributes:
        of: returns the settings class; None: it is in `Form.settings`, by the name of the field (for example one for
            each tracking method).
        only: names of the settings that can be given; empty: all.
        without: names of settings that cannot be given.
        under: prefix of the settings' options.
        plain: names of settings with options without that prefix.
        prefix: prefix of the settings' names in Python, where options have none.
        example: example of `--set NAME=VALUE`, by which settings without an option are given; empty: they cannot be
            given.
        nested: in Python the settings are one argument with the field's name, a mapping; otherwise each is an argument.
    """

    of: Callable[[], type[Settings]] | None
    only: Collection[str] = ()
    without: Collection[str] = ()
    under: str = ""
    plain: Collection[str] = ()
    prefix: str = ""
    example: str = ""
    nested: bool = False


@dataclass(frozen=True)
class PluginField:
    """Declaration of a request's field that contains selected plug-ins with their settings.

    Attributes:
        kind: kind of plug-in.
        help: help text, one or more sentences.
        option: option as click declares it, which may be repeated.
        kinds: kinds of input that the plug-ins apply to, as in `File`; empty: all.
    """

    kind: str
    help: str
    option: str
    kinds: tuple[str, ...] = ()


def plugged(kind: str, help: str, option: str, kinds: tuple[str, ...] = ()) -> Any:
    """Declare a request's field of selected plug-ins: a tuple of `occlog.plugins.loading.Chosen`, empty by default.

    Args:
        kind: kind of plug-in, for example `metric`.
        help: help text of the option.
        option: option of the command, which may be repeated.
        kinds: kinds of input that the plug-ins apply to; empty: all.
    """
    return field(default=(), metadata={"plugged": PluginField(kind, help, option, kinds)})


def source(help: str, *, required: bool | None = None, **declared_of: Any) -> Any:
    """Declare a request's field that names a file to read.

    Args:
        help: help text of the option.
        required: whether the file must be given; None: positional arguments must, options need not.
        **declared_of: further attributes of the `File` declaration.
    """
    of = File(help, **declared_of)
    return _file(of, of.argument if required is None else required)


def sink(help: str, table: str = "", *, required: bool = False, **declared_of: Any) -> Any:
    """Declare a request's field that names a file to write.

    Args:
        help: help text of the option.
        table: name of the table that the file contains; empty: none.
        required: whether it must be given; if not, the default is None, and nothing is written.
        **declared_of: further attributes of the `File` declaration.
    """
    return _file(File(help, output=True, table=table, **declared_of), required)


def _file(of: File, required: bool) -> Any:
    metadata = {"file": of}
    return field(metadata=metadata) if required else field(default=None, metadata=metadata)


def output_file(help: str, table: str = "", result: str = "") -> Any:
    """Declare the main output of a command, `-o/--output`, which is required.

    Args:
        help: help text of the option.
        table: name of the table that the file contains; empty: none.
        result: name of the output in results of the Python API; empty: that of the table.
    """
    return sink(help, table, required=True, option="-o/--output", result=result)


def scene_file(needed: str = "") -> Any:
    """Declare the option `--scene`: a file with a scene, in place of the scene in the input.

    `needed`: what the command needs of the scene, where a table of sensor positions does not have it.
    """
    return source(
        f"Scene file (YAML), or a recording that contains one, with {needed}." if needed else SCENE_HELP, scene=True
    )


def seed_of_all() -> Any:
    """Declare the option `--seed` of all random numbers; by default 0."""
    return setting(0, "Seed of all random numbers; equal seeds give equal results.", at_least=0, option="--seed")


def number_of_threads() -> Any:
    """Declare the option `--workers`, the number of threads; None: one per processor."""
    words = "Number of threads; results do not depend on it. [default: one per processor]"
    return setting(None, words, at_least=1, option="--workers", shown="")


def group(of: Callable[[], type[Settings]] | None, **declared_of: Any) -> Any:
    """Declare a request's field with a group of settings: those that are given, values by name; empty by default.

    Args:
        of: returns the settings class; None: it is in `Form.settings`, by the name of the field.
        **declared_of: further attributes of the `SettingsGroup` declaration.
    """
    return field(default_factory=dict, metadata={"group": SettingsGroup(of, **declared_of)})


@dataclass(frozen=True, kw_only=True)
class Request(Settings):
    """Base class of requests; the docstring of a class is the help of its command.

    Attributes:
        RUN: `module:name` of the function that runs the request; it takes the request and a `Job`, and returns a
            summary and losses.
        JUDGED: the summary has the entry named `VERDICT`.
        VERDICT: name of the summary's entry that states whether all checks passed.
        STRICT: when a failed check gives exit code 6 with `--strict`, as a part of its help; empty: always, without
            `--strict`.
        KIND: `module:name` of the function that determines the kind of a request's input; empty: all options always
            apply.
        KINDS: descriptions of the kinds of input, by kind.
    """

    RUN: ClassVar[str]
    JUDGED: ClassVar[bool] = False
    VERDICT: ClassVar[str] = "plausible"
    STRICT: ClassVar[str] = "if a consistency check fails. Outputs are written anyway."
    KIND: ClassVar[str] = ""
    KINDS: ClassVar[Mapping[str, str]] = {}

    def files(self, *, output: bool) -> dict[str, Path]:
        """Return the files to read (or to write, with `output`) by name of the field, in order of declaration.

        Files of a field with several are named `field`, `field[1]`, `field[2]` and so on; fields without a file are
        missing.
        """
        found: dict[str, Path] = {}
        for f in fields(self):
            value, of = getattr(self, f.name), f.metadata.get("file")
            if of is not None and of.output == output:
                paths = [path for path in _flat(value) if isinstance(path, Path)]
                found |= {f"{f.name}[{n}]" if n else f.name: path for n, path in enumerate(paths)}
        return found

    def file_field(self, field_name: str) -> File:
        """Return the declaration of a field that names files.

        `field_name`: name of the field, or of one of its files as in `files` (`name[1]`).
        """
        found: File = type(self).__dataclass_fields__[field_name.partition("[")[0]].metadata["file"]
        return found

    def kind_of_input(self) -> str:
        """Return the kind of the request's input; empty if the request has no kinds."""
        return str(load(self.KIND)(self)) if self.KIND else ""

    def unfit(self, kind: str) -> Iterator[RequestEntry]:
        """Generate the given options that do not apply to inputs of the kind `kind`."""
        for entry in Form(type(self)).entries():
            value = getattr(self, entry.field)
            value = value.get(entry.of.name) if entry.group is not None else value
            if entry.kinds and kind not in entry.kinds and value is not None and value is not False and value != ():
                yield entry

    def check_kind(self, kind: str) -> None:
        """Raise UsageError for a given option that does not apply to inputs of the kind `kind`.

        The message lists the kinds that it applies to.
        """
        for entry in self.unfit(kind):
            wanted = ", or ".join(self.KINDS[each] for each in entry.kinds)
            raise UsageError(f"{option(entry.key)} is for {wanted}; not for {self.KINDS[kind]}", id="not-applicable")

    @property
    def inputs(self) -> list[Path]:
        """Paths of all input files, in the order of the fields, without duplicates."""
        return list(dict.fromkeys(self.files(output=False).values()))

    @property
    def outputs(self) -> list[Path]:
        """Paths of all output files, in the order of the fields."""
        return list(self.files(output=True).values())


class RequestEntry(NamedTuple):
    """A field of a request, or a setting in one of its groups.

    Attributes:
        key: name, for example `max_gap`; the command line spells it `--max-gap`.
        field: name of the request's field; for a setting that of its group.
        owner: class that declares it: the request's, or the settings class of the group.
        of: the dataclass field of `owner`.
        group: declaration of its group; None: it is a field of the request itself.
        under: prefix of its option.
    """

    key: str
    field: str
    owner: type[Settings]
    of: Field[object]
    group: SettingsGroup | None
    under: str = ""

    @property
    def file(self) -> File | None:
        """Declaration of the file that the field names; None if it names none."""
        found: File | None = self.of.metadata.get("file")
        return found

    @property
    def plugged(self) -> PluginField | None:
        """Declaration of the plug-ins that the field selects; None if it selects none."""
        found: PluginField | None = self.of.metadata.get("plugged")
        return found

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of input that the entry applies to; empty: all."""
        return (self.file or self.plugged or declaration(self.of)).kinds

    @property
    def required(self) -> bool:
        """Whether the field has no default and must be given."""
        return self.of.default is MISSING and self.of.default_factory is MISSING

    @property
    def name(self) -> str:
        """Name of the value among the arguments of a command: that of the field or setting, with its group's prefix."""
        prefix = "" if self.group is None else self.group.prefix
        return prefix + _under(self.under, self.of.name)


@dataclass(frozen=True)
class Form:
    """Form of a request: its class, and which of its fields and settings are offered.

    Attributes:
        request: class of the request.
        takes: names of the offered fields and of settings in groups; None: all.
        settings: settings class of each group that declares none, by the group's field.
        around: further classes with settings that `--set` gives.
        under: prefix of the options of a group by its field, where the group declares none.
    """

    request: type[Request]
    takes: Collection[str] | None = None
    settings: Mapping[str, type[Settings]] = field(default_factory=dict)
    around: tuple[type[Settings], ...] = ()
    under: Mapping[str, str] = field(default_factory=dict)

    def entries(self) -> Iterator[RequestEntry]:
        """Generate all offered fields and settings, in order of declaration."""
        for f in fields(self.request):
            of: SettingsGroup | None = f.metadata.get("group")
            if of is not None:
                yield from self._in_group(f, of)
            elif self.takes is None or f.name in self.takes:
                yield RequestEntry(_key(f), f.name, self.request, f, None)

    def classes(self) -> dict[str, type[Settings]]:
        """Return the settings class of each group of this form, by the name of the group's field.

        A class in `settings` has precedence over the group's own; groups without any class are missing.
        """
        groups = {f.name: f.metadata["group"].of for f in fields(self.request) if "group" in f.metadata}
        made = {name: self.settings.get(name) or (of() if of is not None else None) for name, of in groups.items()}
        return {name: of for name, of in made.items() if of is not None}

    def _in_group(self, f: Field[Any], of: SettingsGroup) -> Iterator[RequestEntry]:
        """Generate the settings of a group that are offered and have an option; `f` is the group's field."""
        settings = self.classes().get(f.name)
        if settings is None:
            return
        for each in declared(settings):
            wanted = (not of.only or each.name in of.only) and each.name not in of.without
            taken = self.takes is None or f.name in self.takes or each.name in self.takes
            under = "" if each.name in of.plain else self.under.get(f.name, of.under)
            if wanted and taken and (under or declaration(each).option is not None):
                yield RequestEntry(_under(under, _key(each)), f.name, settings, each, of, under)

    def set_group(self) -> tuple[str, str] | None:
        """Return (field, example of NAME=VALUE) of the group to which `--set` gives settings; None if there is none."""
        groups = ((f.name, f.metadata["group"].example) for f in fields(self.request) if "group" in f.metadata)
        return next(((name, example) for name, example in groups if example), None)

    def build(self, given: Mapping[str, object], groups: Mapping[str, Mapping[str, object]]) -> Request:
        """Return the request with the given values; others have their defaults.

        Args:
            given: values by `RequestEntry.name`; None and () count as not given. Texts are parsed to the type of the
                field.
            groups: settings of groups by field; the values in `given` take precedence.

        Raises:
            SettingError: a value of the request's own fields is out of its range.
            UsageError: an invalid text, or a required field is missing.
        """
        values: dict[str, Any] = {name: dict(group) for name, group in groups.items()}
        for entry in self.entries():
            value = given.get(entry.name)
            if value is None or value == ():
                continue
            if entry.group is not None:
                values.setdefault(entry.field, {})[entry.of.name] = value
            elif isinstance(value, str) and entry.file is None:
                values[entry.field] = read_value(value, kind_of(entry.owner, entry.of.name), entry.key)
            else:
                values[entry.field] = value
        for entry in self.entries():
            if entry.group is None and entry.required and entry.field not in values:
                raise UsageError(f"{option(entry.key)} is missing; give it", id="missing-option")
        return self.request(**values)


@dataclass(frozen=True)
class Verbs:
    """Several commands under one name, such as `occlog priors hull`.

    Attributes:
        help: help of the common name.
        verbs: (class of requests, summary in one line) by the command's own name.
    """

    help: str
    verbs: Mapping[str, tuple[type[Request], str]]


@dataclass(frozen=True)
class VerbKind:
    """Kind of a request, for a command that has several kinds.

    Attributes:
        summary: summary in one line.
        form: returns the form of its request.
        called: how this kind is chosen on the command line; None: as `Verb.chosen_by` states.
        about: paragraphs of its help, with an example; None: the help of the command.
    """

    summary: str
    form: Callable[[], Form]
    called: str | None = None
    about: str | None = None


@dataclass(frozen=True)
class Verb:
    """A command with several kinds of requests, of which options or inputs choose one.

    Attributes:
        shared: base class of all the requests; its fields are those of every kind.
        kinds: kinds by name.
        default: kind if nothing else chooses one.
        by: functions by key of an option: they return the kind for the option's value, or an empty text if it chooses
            none; the first option that is given and chooses one decides.
        counted: kinds by least number of positional arguments, where no option chooses one; the largest number that is
            reached decides.
        fits: `module:name` of the function that returns the kind which fits the contents of the first input, given its
            path and that of a scene (or None), where no option chooses one; empty: none.
        what: word for a kind, for example `method`.
        chosen_by: how a kind is chosen on the command line, with {} for its name.
        more: returns the kinds of installed plug-ins, by name.
        shows_default: help without a choice also lists the options of the default kind.
        example: example of `--set`; empty: no kind has settings without an option.
    """

    shared: type[Request]
    kinds: Mapping[str, VerbKind]
    default: str
    by: Mapping[str, Callable[[str], str]]
    counted: Mapping[int, str] = field(default_factory=dict)
    fits: str = ""
    what: str = "kind"
    chosen_by: str = "{}"
    more: Callable[[], Mapping[str, VerbKind]] = dict
    shows_default: bool = True
    example: str = ""

    @property
    def help(self) -> str | None:
        """Help of the command: the docstring of the base class of its requests."""
        of = self.shared
        while of.__base__ not in (Request, None):
            of = of.__base__
        return of.__doc__

    def kind(self, name: str) -> VerbKind | None:
        """Return the built-in or plugged-in kind `name`; None if there is none."""
        # In lists, since Python code may give a value without a hash
        if name in [*self.kinds]:
            return self.kinds[name]
        more = self.more()
        return more[name] if name in [*more] else None

    def form(self, name: str) -> Form:
        """Return the form of the kind `name`.

        Raises:
            UsageError: an unknown kind; the message has the most similar name.
        """
        kind = self.kind(name)
        if kind is None:
            raise UsageError(
                f"no {self.what} {name!r}; {did_you_mean(name, [*self.kinds, *self.more()])}", id="unknown-name"
            )
        return kind.form()


def _flat(value: object) -> Iterator[object]:
    """Generate the items of a nested tuple; a value that is no tuple is the only item."""
    if isinstance(value, tuple):
        for each in value:
            yield from _flat(each)
    else:
        yield value


def _key(f: Field[Any]) -> str:
    """Return the key of a request's field or of a setting: the name of its option with `_` for `-`, or its own name."""
    of: File | PluginField | Declaration = f.metadata.get("file") or f.metadata.get("plugged") or declaration(f)
    option = of.option
    if option is None or getattr(of, "argument", False):
        return f.name
    long = next(flag for flag in option.split("/") if flag.startswith("--"))
    return long.removeprefix("--").replace("-", "_")


def _under(under: str, name: str) -> str:
    """Return a name with a prefix and `_` before it as a Python identifier; without a prefix the name itself.

    Other characters of the prefix `under` than letters and digits become `_`.
    """
    return "".join(c if c.isalnum() else "_" for c in f"{under}_") + name if under else name


def load(where: str) -> Any:
    """Return the object that `where` names as `module:name`, after importing the module."""
    module, _, name = where.partition(":")
    return getattr(importlib.import_module(module), name)
