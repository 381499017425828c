"""Errors for users, and the exit codes of the command line.

Every message is one line that names the file, the position in it, the value and the limit that it violates, and the
remedy. Every error has the id of its kind.
"""

import functools
import re
from collections.abc import Callable, Iterable, Mapping
from contextvars import ContextVar
from enum import IntEnum

LONGEST_LIST = 200
"""Largest number of characters of a list of valid names in a message."""
_OPTION = re.compile(r"(?:\ue000|\\ue000)([\w.]+)(?:\ue001|\\ue001)")


def as_flag(name: str) -> str:
    """Return a request field as typed on the command line: `--fused-views`, `--set person_height=`."""
    free = name.removeprefix("set.")
    return f"--{name.replace('_', '-')}" if free == name else f"--set {free}="


SPELLING: ContextVar[Callable[[str], str]] = ContextVar("SPELLING", default=as_flag)
"""Spelling of a request's field on the surface in use."""


def option(name: str) -> str:
    """Return a placeholder for a request field in a message, which `spelled` replaces for the surface in use.

    A setting without its own option is called `set.NAME`.
    """
    return f"\ue000{name}\ue001"


def spelled(text: str) -> str:
    """Return a message (or JSON with one) with the names of `option` spelled for the surface in use."""
    return _OPTION.sub(lambda found: SPELLING.get()(found[1]), text)


class ExitCode(IntEnum):
    """Exit status of an `occlog` command: 0 is success."""

    DONE = 0
    BUG = 1
    USAGE = 2
    LOSSY = 3  # finished, but input was lost while reading; the losses are listed
    BAD_INPUT = 4  # bad or unreadable input, or a file that cannot be written
    DIFFERENT = 5  # `diff` found a difference
    THRESHOLD = (
        6  # `--fail-if` was not met, `--strict` and not plausible, or matches that do not fit (`epipolar --check`)
    )
    EXISTS = 7  # the output exists and --overwrite was not given
    INTERRUPTED = 130
    PIPE = 141  # the reader of standard output has gone, as in `| head`
    TERMINATED = 143  # SIGTERM, as a queue of jobs or a service manager sends it


class OcclogError(Exception):
    """Base class of all deliberate errors; `exit_code` is returned by the command, `id` is the kind of error."""

    exit_code: ExitCode = ExitCode.BAD_INPUT
    default_id = "invalid-value"

    def __init__(self, message: str = "", *, id: str | None = None) -> None:
        """Create an error.

        Args:
            message: what is wrong, in one line.
            id: one of `occlog.records.error_ids.ERRORS`; None: that of the error that caused it (`raise ... from`), or
                the one of the class.
        """
        super().__init__(message)
        self._id = id

    @property
    def id(self) -> str:
        """Stable id of the kind of error, such as `missing-column`; see docs/reference/errors.md."""
        cause = self.__cause__
        if self._id is None and isinstance(cause, OcclogError) and cause is not self:
            return cause.id
        return self._id or self.default_id

    def __str__(self) -> str:
        """Return the message with options spelled for the surface in use."""
        return spelled(super().__str__())

    @property
    def options(self) -> tuple[str, ...]:
        """Names of the request fields in the message; the first is the wrong one."""
        return tuple(_OPTION.findall(super().__str__()))


class InputError(OcclogError):
    """An input is missing, damaged, or states something impossible."""


class OutputError(OcclogError):
    """An output cannot be written (full disk, missing folder, no permission)."""

    default_id = "output-unwritable"


class OutputExistsError(OcclogError):
    """The output exists and may not be overwritten; the command line adds how to replace it."""

    exit_code = ExitCode.EXISTS
    default_id = "output-exists"


class PluginError(OcclogError):
    """A plug-in cannot be imported, fails, or returns something invalid."""

    default_id = "plugin-failed"


class UsageError(OcclogError):
    """Options contradict each other, or are not allowed for this input."""

    exit_code = ExitCode.USAGE
    default_id = "invalid-option"


class NoSceneError(UsageError):
    """A required scene is missing in a file; the command line adds how to give one.

    Attributes:
        where: the file.
    """

    def __init__(self, where: object) -> None:
        """Create the error that the file `where` holds no scene."""
        super().__init__(f"{where}: holds no scene; give one with {option('scene')}", id="missing-scene")
        self.where = where


def did_you_mean(name: str, known: Iterable[str], otherwise: str = "there are", owner: str = "") -> str:
    """Return a hint for an unknown name: `did you mean 'X'?`, or the list of known names if none is similar.

    A long list is cut.

    Args:
        name: the unknown name.
        known: the allowed names.
        otherwise: words before the list of all names.
        owner: method or command that the name was given to; its own renamed options come first.
    """
    names = list(known)
    near = nearest(name, names, owner=owner)
    if near:
        return f"did you mean {' or '.join(map(repr, near))}?"
    listed = ", ".join(names) or "none"
    if len(listed) > LONGEST_LIST:
        listed = listed[:LONGEST_LIST].rpartition(", ")[0]
        listed += f" and {len(names) - listed.count(', ') - 1} more"
    return f"{otherwise} {listed}"


def nearest(name: str, known: Iterable[str], n: int = 1, cutoff: float = 0.6, owner: str = "") -> list[str]:
    """Known names similar to an unknown one, best first; empty if none is similar.

    A name of an earlier release returns its replacements (`renamed.csv`), in any spelling: `--sigma-v`, `sigma_v`. A
    prefix such as `process_noise` returns up to three names.

    Args:
        name: the unknown name.
        known: the names that are valid in its place.
        n: largest number of names that are spelled alike.
        cutoff: least similarity of a close name, 0 to 1, as `difflib` defines it.
        owner: method or command that the name was given to; its own names of the last release come first.
    """
    import difflib

    names = list(known)
    renamed = _renamed().get(_plain(name), ())
    own = [new for of, new in renamed if owner and owner in of.split(", ")]
    successors = own or [new for _, new in renamed]
    return (
        [each for each in names if _plain(each) in successors]
        or [each for each in names if _plain(each).startswith(f"{_plain(name)}_")][:3]
        or difflib.get_close_matches(name, names, n, cutoff)
    )


def _plain(name: str) -> str:
    return name.strip("-= ").removeprefix("no-").replace("-", "_")


@functools.cache
def _renamed() -> Mapping[str, tuple[tuple[str, str], ...]]:
    """Owner (method or table), old name and new name of each public name renamed since the last release."""
    import csv
    from importlib import resources

    text = (resources.files("occlog") / "renamed.csv").read_text("utf-8")
    found: dict[str, tuple[tuple[str, str], ...]] = {}
    for row in csv.DictReader(text.splitlines()):
        found[_plain(row["old"])] = (*found.get(_plain(row["old"]), ()), (row["owner"], _plain(row["new"])))
    return found
