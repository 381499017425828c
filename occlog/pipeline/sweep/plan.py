"""Sweep files: fixed settings, varied settings, and the trials of all their combinations."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import msgspec
from msgspec import Meta

from occlog.console.text import counted
from occlog.errors import InputError, UsageError, did_you_mean
from occlog.io.files.limits import bounded_text
from occlog.io.files.texts.yaml import lines_of, read_yaml
from occlog.settings import SettingError, Settings, check_setting
from occlog.simulate.config import ObserveConfig, WorldConfig
from occlog.track.catalogue import BEARINGS, entry
from occlog.track.catalogue import settings_of as settings_of_method
from occlog.track.methods.apf.config import SelectConfig

from .trial import PRIORS

PARTS = ("simulate", "observe", "priors", "track", "select")
PRIOR_NUMBERS = ("measurement_noise", "process_noise_velocity")
"""Numbers of the part `priors`."""
WHOLE = ("cameras", "skip")
"""Entries of a trial that are varied as a whole, not by `part.key`."""
MAX_TRIALS = 1_000_000


class SweepSpec(msgspec.Struct, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """Content of a sweep file: scene, settings of all trials, and those that vary."""

    occlog_sweep: Annotated[Literal[1], Meta(description="version of this format")]
    scene: Annotated[str, Meta(description="scene file, next to the sweep file")]
    seed: Annotated[int, Meta(ge=0)] = 0
    runs: Annotated[int, Meta(ge=1, description="runs of every setting, each with its own world")] = 5
    simulate: Annotated[dict[str, object], Meta(description="as the options of `occlog simulate`")] = {}
    observe: Annotated[
        dict[str, object], Meta(description="pose_noise, miss_probability, false_alarm_probability, diameter")
    ] = {}
    priors: Annotated[
        dict[str, object], Meta(description="kind: none, known or kalman; measurement_noise; process_noise_velocity")
    ] = {}
    track: Annotated[dict[str, object], Meta(description="method and its settings")] = {}
    select: (
        Annotated[dict[str, object], Meta(description="policy, n_cameras, selection_interval, model, camera_order")]
        | None
    ) = None
    cameras: Annotated[list[str] | int | None, Meta(description="names, or how many of `order`; all")] = None
    order: Annotated[list[str], Meta(description="order in which cameras are used")] = []
    skip: Annotated[int, Meta(ge=0, description="estimates skipped at the start")] = 0
    vary: Annotated[dict[str, list[object]], Meta(description="values to be combined with each other")] = {}
    cases: Annotated[list[dict[str, object]], Meta(description="named settings, each combined with `vary`")] = []


class Setting(NamedTuple):
    """One combination of the varied values.

    Attributes:
        label: the varied values by name.
        trials: specification of the trial of each run.
    """

    label: dict[str, object]  # the varied values by name
    trials: tuple[dict[str, object], ...]  # one for each run


def read_sweep(path: Path) -> SweepSpec:
    """Read a sweep file; InputError names the line of a wrong entry, and the nearest valid key."""
    return read_yaml(path, SweepSpec, "a sweep file")


def check_values(path: Path, spec: SweepSpec, settings: Sequence[Setting]) -> None:
    """Check the values of all settings before any trial runs; InputError with the line of the file.

    Args:
        path: path of the sweep file.
        spec: its content.
        settings: combinations that are run.
    """
    lines, checked = lines_of(path), set[str]()
    cases = spec.cases or [{}]
    for number, setting in enumerate(settings):
        case = number * len(cases) // len(settings)
        trial = setting.trials[0]
        for part in PARTS:
            values = trial.get(part)
            if not isinstance(values, Mapping):
                continue
            for name, value in values.items():
                location, at = _place(spec, case, f"{part}.{name}", value)
                method = str(values.get("method", "apf")) if part == "track" else ""
                key = f"{location} {method} {value!r}"
                if key in checked:
                    continue
                checked.add(key)
                line = f"line {lines[at]}: " if at in lines else ""
                try:
                    _check_value(part, method, name, value)
                except SettingError as error:
                    raise InputError(f"{path}: {line}{location}: {value}: must be {error.limit}") from error
                except UsageError as error:
                    raise InputError(f"{path}: {line}{location}: {error}") from error


def _check_value(part: str, method: str, name: str, value: object) -> None:
    """Check one value of a trial; UsageError if it is not allowed.

    Args:
        part: part of a trial, for example `track`.
        method: tracking method, if the part is `track`.
        name: name of the setting.
        value: to check.
    """
    if part == "priors":
        _check_priors(name, value)
        return
    if part == "track" and name == "method":
        if entry(str(value)).takes_in != BEARINGS:
            raise UsageError(
                f"{value} takes no bearings, which trials make; name a method that does, e.g. apf", id="not-applicable"
            )
        return
    of: dict[str, type[Settings]] = {"simulate": WorldConfig, "observe": ObserveConfig, "select": SelectConfig}
    given = tuple(value) if isinstance(value, list) else value
    check_setting([of[part] if part in of else settings_of_method(method)], name, given)


def _check_priors(name: str, value: object) -> None:
    if name not in ("kind", *PRIOR_NUMBERS):
        raise UsageError(f"unknown key; {did_you_mean(name, ('kind', *PRIOR_NUMBERS))}", id="unknown-key")
    if name == "kind" and value not in PRIORS:
        raise UsageError(f"{value!r}: must be one of {', '.join(PRIORS)}", id="unknown-name")
    if name in PRIOR_NUMBERS and (isinstance(value, bool) or not isinstance(value, int | float) or value <= 0):
        raise UsageError(f"{value!r}: must be a number above 0")


def _place(spec: SweepSpec, case: int, name: str, value: object) -> tuple[str, str]:
    """Return the location of a trial's value in the sweep file: for messages, and as a key of `lines_of`.

    Args:
        spec: content of the file.
        case: index of the case.
        name: part and setting, as `track.particles`.
        value: value of the trial, which is searched for in the setting's list.
    """
    if name in spec.vary:
        return f"vary.{name}", f"$.vary.{name}[{spec.vary[name].index(value)}]"
    if spec.cases and name in spec.cases[case]:
        return f"cases[{case}].{name}", f"$.cases[{case}].{name}"
    return name, f"$.{name}"


def settings_of(path: Path, spec: SweepSpec) -> list[Setting]:
    """Return all combinations of the varied values, in file order, with their trials; the last name varies fastest.

    Args:
        path: the sweep file, in the folder of the scene.
        spec: its content.

    Raises:
        InputError: a name that cannot vary, an empty list, too many trials, or cameras that do not exist.
    """
    scene = bounded_text(path.parent / spec.scene, "a scene")
    try:
        return _combined(spec, scene)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _combined(spec: SweepSpec, scene: str) -> list[Setting]:
    for name, values in spec.vary.items():
        if not values:
            raise InputError(f"vary: {name}: has no values; give at least one", id="missing-value")
    axes = [[(name, value) for value in values] for name, values in spec.vary.items()]
    cases: list[dict[str, object]] = spec.cases or [{}]
    count = len(cases) * spec.runs
    for axis in axes:
        count *= len(axis)
    if count > MAX_TRIALS:
        raise InputError(f"{count} trials, limit {MAX_TRIALS}; vary less or lower runs", id="problem-too-large")
    found = []
    for case in cases:
        for combination in itertools.product(*axes):
            label = {**case, **dict(combination)}
            found.append(Setting(label, _trials(spec, scene, label)))
    return found


def _trials(spec: SweepSpec, scene: str, label: Mapping[str, object]) -> tuple[dict[str, object], ...]:
    trial: dict[str, object] = {"scene": scene, "seed": spec.seed, "skip": spec.skip, "cameras": spec.cameras}
    for part in PARTS:
        value = getattr(spec, part)
        if value is not None:
            trial[part] = dict(value)
    for name, value in label.items():
        if name != "name":
            _put(trial, name, value)
    trial["cameras"] = _cameras(trial["cameras"], spec.order)
    skip = trial["skip"]
    if not isinstance(skip, int) or isinstance(skip, bool) or skip < 0:
        raise InputError(f"skip: {skip!r}: expected a whole number of at least 0")
    return tuple({**trial, "run": run} for run in range(spec.runs))


def _put(trial: dict[str, object], name: str, value: object) -> None:
    part, dot, key = name.partition(".")
    if not dot and name in WHOLE:
        trial[name] = value
    elif not dot and name == "select" and value is None:
        trial.pop("select", None)
    elif dot and part in PARTS:
        before = trial.get(part)
        trial[part] = {**(before if isinstance(before, dict) else {}), key: value}
    else:
        raise InputError(
            f"vary: {name}: expected {' or '.join(WHOLE)}, or a part and its key, e.g. track.particles "
            f"(parts: {', '.join(PARTS)})",
            id="unknown-key",
        )


def _cameras(value: object, order: Sequence[str]) -> list[str] | None:
    """Return the names of the cameras in use; None: all cameras. InputError for an invalid value.

    Args:
        value: names, a number (the first ones of `order` are used), or None.
        order: names of cameras.
    """
    if value is None or (isinstance(value, list) and all(isinstance(name, str) for name in value)):
        return value
    if not isinstance(value, int) or isinstance(value, bool) or not 1 <= value <= len(order):
        names = (
            f"the {counted(len(order), 'name')} in `order`" if order else "some names in `order`, which is not there"
        )
        raise InputError(f"cameras: {value!r}: expected a list of names, or how many of {names} to use")
    return list(order[:value])
