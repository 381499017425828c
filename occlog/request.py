"""Request of a command, declared once: command line options, Python arguments and YAML keys are made from it.

A class of requests derives from `Request`. Its fields are files to read (`source`) and to write (`sink`), values
(`occlog.settings.setting`) and groups of settings (`group`). A field has one name, the key that YAML has for it; the
command line spells it `--fused-views`, Python `fused_views`. A field with an option of another name is called by that
name everywhere.
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
SCENE_HELP = "Scene file (YAML), a recording that contains one, or a text table of stations."


@dataclass(frozen=True)
class File:
    """Declaration of a field that names one or several files.

    Attributes:
        help: one sentence or more.
        output: it is written; else it is read.
        table: output: name of the table in it; empty: it is no table, or the run decides.
        result: output: its name in the result of the Python function; empty: that of the field, or of the table of the
            main output.
        asked: output: the Python function asks for it: `always`, `also` (by its argument `also`), `never`, or where
            the argument of that name is given.
        option: as click writes it (`-o/--output`); None: the field's name.
        metavar: how the option's value is called.
        argument: it is an argument without a name.
        together: of a field of several files this many are given at a time.
        number: a number from this on may be in place of the file; None: no number may.
        scene: a scene is read from it.
        there: click checks that it exists, and `-` is standard input.
        kinds: kinds of input that it is for, where the request is of several (`Request.KIND`); empty: all.
        suffix: output: how the name of the file ends that a Python function makes.
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
    """Declaration of a field that holds given settings of a class, by name.

    Attributes:
        of: makes the class; None: the form of the request states which (a tracking method, for example).
        only: names of settings that can be given; empty: all.
        without: names of settings that cannot.
        under: what the names of the options begin with.
        plain: names of settings of which they do not.
        prefix: what names in Python begin with, where those of the options do not.
        example: of `--set NAME=VALUE`, which gives settings without an option; empty: nothing does.
        nested: in Python they are one argument of the field's name, a mapping; else each is an argument.
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
    """Declaration of a field that holds selected plug-ins with their settings.

    Attributes:
        kind: of the plug-ins.
        help: one sentence or more.
        option: as click writes it; it may be repeated.
        kinds: kinds of input that they are for; see `File`.
    """

    kind: str
    help: str
    option: str
    kinds: tuple[str, ...] = ()


def plugged(kind: str, help: str, option: str, kinds: tuple[str, ...] = ()) -> Any:
    """Declare a request field of selected plug-ins, a tuple of `occlog.plugins.loading.Chosen`; by default empty.

    Args:
        kind: kind of plug-in, for example `filter`.
        help: text for the help of the option.
        option: the command's option, which may be repeated.
        kinds: kinds of input that the plug-ins are for; empty: all.
    """
    return field(default=(), metadata={"plugged": PluginField(kind, help, option, kinds)})


def source(help: str, *, required: bool | None = None, **declared_of: Any) -> Any:
    """Declare a field that names a file to read.

    Args:
        help: sentence for the help of the option.
        required: None: positional arguments are required, options are not.
        **declared_of: further fields of the `File` declaration.
    """
    of = File(help, **declared_of)
    return _file(of, of.argument if required is None else required)


def sink(help: str, table: str = "", *, required: bool = False, **declared_of: Any) -> Any:
    """Declare a request field that names a file to write.

    Args:
        help: sentence for the help of the option.
        table: name of the table that the file holds; empty: it holds none.
        required: false: the default is None, and nothing is written.
        **declared_of: further fields of the `File` declaration.
    """
    return _file(File(help, output=True, table=table, **declared_of), required)


def _file(of: File, required: bool) -> Any:
    metadata = {"file": of}
    return field(metadata=metadata) if required else field(default=None, metadata=metadata)


def output_file(help: str, table: str = "", result: str = "") -> Any:
    """Declare the main output of a command, `-o/--output`, which is required.

    Args:
        help: sentence for the help of the option.
        table: name of the table that it holds; empty: none.
        result: name of the output in the results of the Python interface; empty: that of the table.
    """
    return sink(help, table, required=True, option="-o/--output", result=result)


def scene_file() -> Any:
    """Declare the scene option, which replaces the scene of the input."""
    return source(SCENE_HELP, scene=True)


def seed_of_all() -> Any:
    """Declare the field for the seed of all random numbers, `--seed`."""
    return setting(0, "Seed of all random numbers; equal seeds give equal results.", at_least=0, option="--seed")


def number_of_threads() -> Any:
    """Declare the number of threads, `--workers`; None: one for each processor."""
    words = "Number of threads; results do not depend on it. [default: one per processor]"
    return setting(None, words, at_least=1, option="--workers", shown="")


def group(of: Callable[[], type[Settings]] | None, **declared_of: Any) -> Any:
    """Declare a field that holds settings of a class."""
    return field(default_factory=dict, metadata={"group": SettingsGroup(of, **declared_of)})


@dataclass(frozen=True, kw_only=True)
class Request(Settings):
    """Base class of requests; the docstring of a class is the help of its command.

    `RUN` is module and name of the function that does it: from the request and a `Job` to a summary and losses.
    `JUDGED`: the summary has the figure `VERDICT` (whether all is well); `STRICT` states when False gives exit code 6
    with `--strict` (empty: always). `KIND` is module and name of the function that determines the kind of input, and
    `KINDS` are names of these kinds; without these all declared options apply.
    """

    RUN: ClassVar[str]
    JUDGED: ClassVar[bool] = False
    VERDICT: ClassVar[str] = "plausible"
    STRICT: ClassVar[str] = "if a consistency check fails. Outputs are written anyway."
    KIND: ClassVar[str] = ""
    KINDS: ClassVar[Mapping[str, str]] = {}

    def files(self, *, output: bool) -> dict[str, Path]:
        """Files to read (or write, with `output`) by field, in order of declaration; items of a tuple separately."""
        found: dict[str, Path] = {}
        for f in fields(self):
            value, of = getattr(self, f.name), f.metadata.get("file")
            if of is not None and of.output == output:
                paths = [path for path in _flat(value) if isinstance(path, Path)]
                found |= {f"{f.name}[{n}]" if n else f.name: path for n, path in enumerate(paths)}
        return found

    def file_field(self, field_name: str) -> File:
        """Return the declaration of the file field `field_name`; items of a tuple are named `name[1]`."""
        found: File = type(self).__dataclass_fields__[field_name.partition("[")[0]].metadata["file"]
        return found

    def kind_of_input(self) -> str:
        """Return the kind of the request's input; empty if there are no kinds."""
        return str(load(self.KIND)(self)) if self.KIND else ""

    def unfit(self, kind: str) -> Iterator[RequestEntry]:
        """Generate the given options that do not apply to a kind of input."""
        for entry in Form(type(self)).entries():
            value = getattr(self, entry.field)
            value = value.get(entry.of.name) if entry.group is not None else value
            if entry.kinds and kind not in entry.kinds and value is not None and value is not False and value != ():
                yield entry

    def check_kind(self, kind: str) -> None:
        """UsageError, which lists the applicable kinds, for an option that does not apply to a kind of input."""
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
    """A field or setting of a request.

    Attributes:
        key: its name, which all surfaces spell.
        field: of the request.
        owner: class that declares it: the request's, or that of the settings of a group.
        of: the declaration, a field of the owner.
        group: that it is in; None: it is a field of the request itself.
        under: what the name of its option begins with.
    """

    key: str
    field: str
    owner: type[Settings]
    of: Field[object]
    group: SettingsGroup | None
    under: str = ""

    @property
    def file(self) -> File | None:
        """Declaration of the file that the field names; None if the field is no file."""
        found: File | None = self.of.metadata.get("file")
        return found

    @property
    def plugged(self) -> PluginField | None:
        """Declaration of the plug-ins that the field selects; None if it selects none."""
        found: PluginField | None = self.of.metadata.get("plugged")
        return found

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of input to which it applies; empty: all."""
        return (self.file or self.plugged or declaration(self.of)).kinds

    @property
    def required(self) -> bool:
        """Whether the field has no default and must be given."""
        return self.of.default is MISSING and self.of.default_factory is MISSING

    @property
    def name(self) -> str:
        """Name of the value in a command: the field's name with the prefix of its group."""
        prefix = "" if self.group is None else self.group.prefix
        return prefix + _under(self.under, self.of.name)


@dataclass(frozen=True)
class Form:
    """Form of a request: its class, with the fields and settings that are offered.

    Attributes:
        request: its class.
        takes: names of fields and of settings in groups; None: all that there are.
        settings: classes of the groups that declare none, by their fields.
        around: more classes of which `--set` gives settings.
        under: what the names of a group's options begin with, by its field, where the group declares nothing.
    """

    request: type[Request]
    takes: Collection[str] | None = None
    settings: Mapping[str, type[Settings]] = field(default_factory=dict)
    around: tuple[type[Settings], ...] = ()
    under: Mapping[str, str] = field(default_factory=dict)

    def entries(self) -> Iterator[RequestEntry]:
        """All fields and settings with their own names, in order of declaration."""
        for f in fields(self.request):
            of: SettingsGroup | None = f.metadata.get("group")
            if of is not None:
                yield from self._in_group(f, of)
            elif self.takes is None or f.name in self.takes:
                yield RequestEntry(_key(f), f.name, self.request, f, None)

    def classes(self) -> dict[str, type[Settings]]:
        """Settings class of each group of this form, by field."""
        groups = {f.name: f.metadata["group"].of for f in fields(self.request) if "group" in f.metadata}
        made = {name: self.settings.get(name) or (of() if of is not None else None) for name, of in groups.items()}
        return {name: of for name, of in made.items() if of is not None}

    def _in_group(self, f: Field[Any], of: SettingsGroup) -> Iterator[RequestEntry]:
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
        """Field of the settings for `--set`, and an example; None if there is none."""
        groups = ((f.name, f.metadata["group"].example) for f in fields(self.request) if "group" in f.metadata)
        return next(((name, example) for name, example in groups if example), None)

    def build(self, given: Mapping[str, object], groups: Mapping[str, Mapping[str, object]]) -> Request:
        """Build the request from given values.

        Args:
            given: by `RequestEntry.name`; None and () are not given.
            groups: settings of groups, by field; those of `given` count more.

        Raises:
            SettingError: a value of the request's own that is out of its range.
            UsageError: a text that is no value, or something that is required is missing.
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
        help: of the name alone.
        verbs: the request of each by its name, with what it does in one line.
    """

    help: str
    verbs: Mapping[str, tuple[type[Request], str]]


@dataclass(frozen=True)
class VerbKind:
    """A kind of request of a command.

    Attributes:
        summary: one line.
        form: makes the form of its request.
        called: how it is chosen, if not as the others are.
        about: paragraphs of its help, with an example; None: the help is that of the verb.
    """

    summary: str
    form: Callable[[], Form]
    called: str | None = None
    about: str | None = None


@dataclass(frozen=True)
class Verb:
    """A command with several kinds of requests, selected by a value.

    Attributes:
        shared: class of which all requests are; its fields are those of all kinds.
        kinds: by name.
        default: the kind where no value chooses one.
        by: keys of the values that choose, the first that is given before the others, and which kind a text of the
            value chooses; empty: none.
        counted: kinds that this many arguments choose where no value does; more choose that of the largest number.
        fits: module and name of a function from the name of the first input, and that of a scene or None, to the kind
            that fits their content, where no value chooses one; empty: the default.
        what: how a kind is called, for example `method`.
        chosen_by: how a kind is chosen on the command line, with {} for its name.
        more: makes kinds of plug-ins.
        shows_default: help without a choice shows what the default kind takes, too.
        example: of `--set`; empty: no kind has settings without an option.
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
        """Help of the command: docstring of the base class of its requests."""
        of = self.shared
        while of.__base__ not in (Request, None):
            of = of.__base__
        return of.__doc__

    def kind(self, name: str) -> VerbKind | None:
        """Kind of that name, built in or of a plug-in; None if missing."""
        return self.kinds[name] if name in self.kinds else self.more().get(name)

    def form(self, name: str) -> Form:
        """Form of a kind; UsageError, with the most similar name, for an unknown kind."""
        kind = self.kind(name)
        if kind is None:
            raise UsageError(
                f"no {self.what} {name!r}; {did_you_mean(name, [*self.kinds, *self.more()])}", id="unknown-name"
            )
        return kind.form()


def _flat(value: object) -> Iterator[object]:
    """Generate the items of nested tuples in `value`; another value is one item."""
    if isinstance(value, tuple):
        for each in value:
            yield from _flat(each)
    else:
        yield value


def _key(f: Field[Any]) -> str:
    """Return the key of a request field `f`: the name of its option, with `_`, or its own."""
    of: File | PluginField | Declaration = f.metadata.get("file") or f.metadata.get("plugged") or declaration(f)
    option = of.option
    if option is None or getattr(of, "argument", False):
        return f.name
    long = next(flag for flag in option.split("/") if flag.startswith("--"))
    return long.removeprefix("--").replace("-", "_")


def _under(under: str, name: str) -> str:
    """Return `name` with the prefix `under` as a Python identifier: `_` in it for other characters, and after it."""
    return "".join(c if c.isalnum() else "_" for c in f"{under}_") + name if under else name


def load(where: str) -> Any:
    """Import the object that `where` names as `module:name`."""
    module, _, name = where.partition(":")
    return getattr(importlib.import_module(module), name)
