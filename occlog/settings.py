"""Settings: declared once, with default, unit, range and help.

A class of settings derives from `Settings`; each of its fields is a `setting(...)`. From the declaration derive the
check of its values, the reading of texts (`--set NAME=VALUE`), the options of the command line
(`occlog.cli.setting_options`), the JSON Schema and the pages of the documentation. Modules that declare settings import
nothing heavy, so that `--help` is fast.
"""

from __future__ import annotations

import functools
import math
import numbers
import re
import types
import typing
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import Field, dataclass, field, fields, replace
from typing import Any, ClassVar, Self, TypeVar

from occlog.errors import InputError, UsageError, did_you_mean

METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001, "ft": 0.3048, "in": 0.0254}
"""Metres in one unit of length; a scene may have its own unit also."""
LENGTH_POWER = {"length": 1, "length/s": 1, "length/s^2": 1, "length^2": 2, "length^2/s^3": 2}
"""Units that are a length to some power, times something that does not depend on the unit of length."""
METAVARS = {"s": "SECONDS", "length": "LENGTH", "px": "PX", "deg": "DEGREES", "Hz": "HZ", "dB": "DB", "dBm": "DBM"}
"""Placeholders of values in the help, by the unit, for options that declare none."""
TRUTHS = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
C = TypeVar("C", bound="Settings")


class SettingError(InputError):
    """Invalid value of a setting.

    Attributes:
        owner: method or command that the setting belongs to.
        setting: name of the setting.
        value: the invalid value.
        limit: condition on the value, in words.
    """

    default_id = "invalid-setting"

    def __init__(self, owner: str, setting: str, value: object, limit: str) -> None:
        super().__init__(f"{owner}: {setting} is {value}, must be {limit}")
        self.owner, self.setting, self.value, self.limit = owner, setting, value, limit


MAX_SETTING, MIN_POSITIVE_SETTING = 1e12, 1e-15
"""Largest number of any setting, either way, and least of those above 0: their squares and quotients are numbers."""
LONG_INTEGERS = ("seed", "_ns")
"""Ends of the names of settings that may be larger: seeds and times [ns]."""
BY_NAME = "--*"
"""Option with the name of its field."""


@dataclass(frozen=True)
class Declaration:
    """Declaration of a setting, in addition to its type and default.

    Attributes:
        help: help text, one or more sentences.
        unit: unit of the value: `s`, `px`, `rad`, `deg`, or a key of `LENGTH_POWER`; empty: a pure number or no number.
        at_least, above, at_most, below: limits of the range; at most one of each pair.
        choices: allowed texts; empty: any value of the type.
        several: the value is several of `choices`, separated by commas.
        counts: allowed lengths of a tuple; empty: any.
        people: default for scenes in metres, feet or inches, given in metres or by unit; None: the common default.
        own: default for scenes with a unit of their own; None: the common default.
        option: option as click declares it (`--lag`, `--shadows/--no-shadows`); `BY_NAME`: that of the field's name;
            None: the setting is given by `--set` only.
        metavar: placeholder for the option's value in the help.
        shown: text for the default in the help; None: the default itself; empty: no text.
        nothing: text for None in the help and documentation.
        scale: factor from the number given in the option to the value, where the option has another unit (degrees).
        repeat: the option may be repeated; each time it adds names, separated by commas.
        apart: the option takes the numbers of a tuple as separate words, without commas.
        whole: with `repeat`: each time the option adds one text, including any commas.
        frames: the option takes two integers as A:B with A < B.
        size: the option takes two integers above 0 as WIDTHxHEIGHT.
        kinds: kinds of input that the setting applies to, where the command has several; empty: all.
    """

    help: str
    unit: str = ""
    at_least: float | None = None
    above: float | None = None
    at_most: float | None = None
    below: float | None = None
    choices: tuple[str, ...] = ()
    several: bool = False
    counts: tuple[int, ...] = ()
    people: object = None
    own: object = None
    option: str | None = None
    metavar: str | None = None
    shown: str | None = None
    nothing: str | None = None
    scale: float = 1.0
    repeat: bool = False
    apart: bool = False
    whole: bool = False
    frames: bool = False
    size: bool = False
    kinds: tuple[str, ...] = ()

    def limit(self) -> str:
        """Return the allowed range as text, for example `above 0 and at most 1` or `one of a, b`.

        Empty if unlimited.
        """
        if self.choices:
            return ("of " if self.several else "one of ") + ", ".join(self.choices)
        ends = (
            ("at least", self.at_least),
            ("above", self.above),
            ("at most", self.at_most),
            ("below", self.below),
        )
        return " and ".join(f"{word} {end:g}" for word, end in ends if end is not None)

    def holds(self, value: Any) -> bool:
        """Return whether a number, text or tuple is allowed: in the range, among the choices or of an allowed length.

        None is always allowed.
        """
        if value is None:
            return True
        if self.choices:
            given = listed(value) if self.several else (value,)
            return bool(given) and set(given) <= set(self.choices)
        if isinstance(value, tuple):
            return not self.counts or len(value) in self.counts
        return (
            (self.at_least is None or value >= self.at_least)
            and (self.above is None or value > self.above)
            and (self.at_most is None or value <= self.at_most)
            and (self.below is None or value < self.below)
        )


def setting(default: Any, help: str, **declared: Any) -> Any:
    """Declare a field of a settings class; the result is the field's default in a dataclass.

    Args:
        default: default value; lengths are in metres (see `default_in`).
        help: help text of the option and of the documentation.
        **declared: further attributes of the `Declaration`.
    """
    return field(default=default, metadata={"setting": Declaration(help, **declared)})


def option_setting(default: Any, help: str, **declared: Any) -> Any:
    """Declare a field that has an option of the field's name: `lag_s` has the option `--lag-s`.

    Args:
        default: default value, as in `setting`.
        help: help text of the option and of the documentation.
        **declared: further attributes of the `Declaration`, except `option`.
    """
    return setting(default, help, option=BY_NAME, **declared)


def like(of: type[Settings], name: str, help: str, **declared: Any) -> Any:
    """Declare a field with the default and the declaration of a field in another settings class.

    Args:
        of: settings class that declares the field.
        name: name of the field in `of`.
        help: help text that replaces the original one.
        **declared: further attributes of the `Declaration` that are replaced.
    """
    other = next(f for f in fields(of) if f.name == name)
    return field(default=other.default, metadata={"setting": replace(declaration(other), help=help, **declared)})


@functools.cache
def declaration(of: Field[object]) -> Declaration:
    """Return the declaration of a field of a settings class, with the option that `BY_NAME` stands for."""
    found: Declaration = of.metadata["setting"]
    return replace(found, option="--" + of.name.replace("_", "-")) if found.option == BY_NAME else found


def listed(text: str) -> tuple[str, ...]:
    """Return the parts of a text between commas, stripped of spaces; empty parts are dropped."""
    return tuple(part.strip() for part in text.split(",") if part.strip())


@dataclass(frozen=True)
class Settings:
    """Base class of settings: an immutable dataclass that is checked on construction.

    Attributes:
        OWNER: name of the method or command that the settings belong to, for messages.

    Raises:
        SettingError: a value of another type or out of its range, or a violated rule between settings.
    """

    OWNER: ClassVar[str]

    def __post_init__(self) -> None:
        for f in declared(type(self)):
            _check(type(self), f, getattr(self, f.name))
        for name, holds, limit in self.rules():
            if not holds:
                raise SettingError(self.OWNER, name, getattr(self, name), limit)

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """Generate the rules between settings: (name of the setting at fault, whether the rule holds, rule as text)."""
        return ()

    @classmethod
    def in_unit(cls, length_unit: str) -> Self:
        """Return the default settings for a scene in `length_unit`."""
        return cls(**{f.name: default_in(f, length_unit) for f in declared(cls)})


def _check(of: type[Settings], f: Field[object], value: Any) -> None:
    """Raise SettingError for a value of another type, not finite, or out of its range.

    Args:
        of: settings class.
        f: field of that class.
        value: value of the field.
    """
    spec, kind = declaration(f), kind_of(of, f.name)
    if not (value is None and optional(kind)) and not _is_a(value, kind):
        raise SettingError(of.OWNER, f.name, repr(value), spec.limit() if spec.choices else KIND_WORDS[item_kind(kind)])
    parts = value if isinstance(value, tuple) else (value,)
    if any(isinstance(n, float) and not math.isfinite(n) for n in parts):
        limit = spec.limit()
        raise SettingError(of.OWNER, f.name, value, "finite" + (f" and {limit}" if limit else ""))
    if any(isinstance(n, float | int) and abs(n) > MAX_SETTING for n in parts) and not f.name.endswith(LONG_INTEGERS):
        raise SettingError(
            of.OWNER, f.name, value, spec.limit() if spec.at_most is not None else f"within {MAX_SETTING:g}"
        )
    if any(isinstance(n, float) and 0.0 < n < MIN_POSITIVE_SETTING for n in parts) and spec.above == 0:
        raise SettingError(of.OWNER, f.name, value, f"{spec.limit()}, at least {MIN_POSITIVE_SETTING:g}")
    if not spec.holds(value):
        raise SettingError(of.OWNER, f.name, value, spec.limit() or counted(spec.counts))


KIND_WORDS: dict[type | tuple[type, type], str] = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "a text",
    (tuple, float): "numbers with commas",
    (tuple, int): "whole numbers with commas",
    (tuple, str): "a list of names",
}
"""Descriptions of the values of each type."""


def item_kind(kind: object) -> type | tuple[type, type]:
    """Return the key in `KIND_WORDS` of an annotated type, without None: a plain type, or (tuple, type of items)."""
    plain = plain_kind(kind)
    if plain is not tuple:
        return plain
    whole = next(k for k in (typing.get_args(kind) or ()) if typing.get_origin(k) is tuple) if optional(kind) else kind
    return tuple, typing.get_args(whole)[0]


def _is_a(value: object, kind: object) -> bool:
    """Return whether a value has the annotated type `kind`, ignoring None.

    An int is accepted as a float, a bool as neither; NumPy scalars are accepted as numbers.
    """
    key = item_kind(kind)
    if isinstance(key, tuple):
        items = {float: numbers.Real, int: numbers.Integral}.get(key[1], str)
        return isinstance(value, tuple) and all(isinstance(v, items) for v in value)
    if key in (int, float):
        return isinstance(value, numbers.Integral if key is int else numbers.Real) and not isinstance(value, bool)
    return isinstance(value, key)


def counted(counts: tuple[int, ...]) -> str:
    """Return the allowed lengths of a tuple setting as text: `2 or 3 numbers`."""
    return " or ".join(str(n) for n in counts) + " numbers"


def declared(of: type[Settings]) -> tuple[Field[object], ...]:
    """Return the fields of a class that are settings, in order of declaration."""
    return tuple(f for f in fields(of) if "setting" in f.metadata)


def default_in(f: Field[object], length_unit: str) -> object:
    """Return the default value of a setting for scenes in `length_unit`.

    Lengths are declared in metres, and converted by the power of length in the setting's unit. In a unit that is not in
    `METRES`, and so specific to the scene, the setting's `own` default applies.

    `f`: field that declares the setting.
    """
    spec = declaration(f)
    if length_unit not in METRES:
        return f.default if spec.own is None else spec.own
    value = f.default if spec.people is None else spec.people
    if isinstance(value, Mapping):
        return value[length_unit]
    power = LENGTH_POWER.get(spec.unit, 0)
    if not power or not isinstance(value, float):
        return value
    metre = 1.0 / METRES[length_unit]
    return value * metre**power


def configure(config: C, values: Mapping[str, object]) -> C:
    """Return a copy of the settings with the given values, by name; texts are parsed to the type of the setting.

    Raises:
        UsageError: an unknown setting, or an invalid text.
        SettingError: a value out of its range.
    """
    return replace(config, **{name: _read(type(config), name, value) for name, value in values.items()})


def check_setting(of: Sequence[type[Settings]], name: str, value: object) -> None:
    """Check the value of a single setting, without the rules between settings.

    Args:
        of: settings classes; the first one that has the setting applies.
        name: name of the setting.
        value: a value, or a text to parse.

    Raises:
        UsageError: no class has the setting, or the text is invalid.
        SettingError: a value out of its range.
    """
    owner = next((each for each in of if name in _names(each)), None)
    if owner is None:
        names = [known for each in of for known in _names(each)]
        raise UsageError(_unknown(of[0].OWNER, name, names), id="unknown-key")
    f = next((f for f in declared(owner) if f.name == name), None)
    read = _read(owner, name, value)
    if f is not None:
        _check(owner, f, read)


def _names(of: type[Settings]) -> list[str]:
    return [f.name for f in fields(of)]


def _read(of: type[Settings], name: str, value: object) -> object:
    """Return the value of a setting; a text is parsed to the type of the setting.

    Raises:
        UsageError: the settings class `of` has no setting `name`, or the text is invalid.
    """
    if name not in _names(of):
        raise UsageError(_unknown(of.OWNER, name, _names(of)), id="unknown-key")
    return read_value(value, kind_of(of, name), name) if isinstance(value, str) else value


def _unknown(owner: str, name: str, known: Sequence[str]) -> str:
    return f"{owner} has no setting {name!r}; {did_you_mean(name, known, 'it has:', owner)}"


def kind_of(of: type, name: str) -> object:
    """Return the annotated type of the setting `name` in the class `of`, for example `float | None`."""
    return _kinds(of)[name]


@functools.cache
def _kinds(of: type) -> Mapping[str, object]:
    """Return the annotated types of all fields of a class, by name; cached, since evaluating annotations is slow."""
    return typing.get_type_hints(of)


def plain_kind(kind: object) -> type:
    """Return the plain type of an annotation: `float` of `float | None`, `tuple` of any tuple."""
    if isinstance(kind, types.UnionType):
        kind = next(k for k in typing.get_args(kind) if k is not types.NoneType)
    return typing.cast(type, typing.get_origin(kind) or kind)


def optional(kind: object) -> bool:
    """Return whether the annotated type `kind` includes None."""
    return isinstance(kind, types.UnionType) and types.NoneType in typing.get_args(kind)


def read_value(text: str, kind: object, name: str) -> object:
    """Parse a text to the value of a setting.

    Args:
        text: text such as `0.5`, `yes` or `a,b`; `none` or an empty text is None where the setting is optional.
        kind: annotated type of the setting.
        name: name of the setting, for messages.

    Raises:
        UsageError: the text is invalid.
    """
    if optional(kind) and text.strip().lower() in ("none", ""):
        return None
    plain = plain_kind(kind)
    try:
        if plain is bool:
            return TRUTHS[text.strip().lower()]
        if plain is tuple:
            _, item = typing.cast(tuple[type, type], item_kind(kind))
            return listed(text) if item is str else tuple(item(part) for part in text.split(","))
        return plain(text)
    except (ValueError, KeyError) as error:
        raise UsageError(
            f"setting {name}: expected {KIND_WORDS[item_kind(kind)]}, got {text!r}", id="invalid-setting"
        ) from error


def read_pair(text: str, size: bool) -> tuple[int, int]:
    """Parse two integers: a range A:B with A < B or, with `size`, a size WIDTHxHEIGHT; a missing A is 0.

    Raises:
        UsageError: any other text.
    """
    pattern = r"(\d{1,5})[xX](\d{1,5})" if size else r"(\d{0,9}):(\d{1,9})"
    found = re.fullmatch(pattern, text.strip())
    first, second = (int(found[1] or 0), int(found[2])) if found is not None else (0, 0)
    if not (first > 0 < second if size else first < second):
        want = "WIDTHxHEIGHT, for example 1920x1080" if size else "A:B with A < B, for example 0:400"
        raise UsageError(f"{text!r}: expected {want}", id="invalid-setting")
    return first, second


def json_schema(of: type[Settings]) -> dict[str, object]:
    """Return the JSON Schema of an object with settings of the class `of`; missing ones have their defaults."""
    properties = {f.name: _property(of, f) for f in declared(of)}
    return {"type": "object", "properties": properties, "additionalProperties": False}


def _property(of: type[Settings], f: Field[object]) -> dict[str, object]:
    """Return the JSON Schema of one setting; a default that differs for scenes in metres is in `default_in_metres`.

    `f`: field of the settings class `of`.
    """
    spec, kind = declaration(f), kind_of(of, f.name)
    names = {int: "integer", float: "number", bool: "boolean", str: "string", tuple: "array"}
    name = names[plain_kind(kind)]
    out: dict[str, object] = {"type": [name, "null"] if optional(kind) else name, "description": spec.help}
    if name == "array":
        out["items"] = {"type": "string" if item_kind(kind) == (tuple, str) else "number"}
        if spec.counts:
            out |= {"minItems": min(spec.counts), "maxItems": max(spec.counts)}
    ends = {
        "minimum": spec.at_least,
        "exclusiveMinimum": spec.above,
        "maximum": spec.at_most,
        "exclusiveMaximum": spec.below,
    }
    out |= {key: end for key, end in ends.items() if end is not None}
    if spec.choices and not spec.several:
        out["enum"] = [*spec.choices, None] if optional(kind) else list(spec.choices)
    if spec.unit:
        out["unit"] = spec.unit
    defaults = {"default": default_in(f, ""), "default_in_metres": default_in(f, "m")}
    if defaults["default_in_metres"] == defaults["default"]:
        del defaults["default_in_metres"]
    return out | {key: list(value) if isinstance(value, tuple) else value for key, value in defaults.items()}
