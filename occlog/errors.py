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
    """Return the name of a request's field as typed on the command line: `--fused-views`, or `--set person_height=`.

    Names that begin with `set.` are settings without an option of their own.
    """
    free = name.removeprefix("set.")
    return f"--{name.replace('_', '-')}" if free == name else f"--set {free}="


SPELLING: ContextVar[Callable[[str], str]] = ContextVar("SPELLING", default=as_flag)
"""Spelling of a request's field on the surface in use."""


def option(name: str) -> str:
    """Return a placeholder for the name of a request's field in a message; `spelled` replaces it.

    A setting without an option of its own is called `set.NAME`.
    """
    return f"\ue000{name}\ue001"


def spelled(text: str) -> str:
    """Return a text with each placeholder of `option` replaced by the name as spelled on the surface in use.

    Surfaces are the command line, Python and YAML. JSON text with escaped placeholders is accepted, too.
    """
    return _OPTION.sub(lambda found: SPELLING.get()(found[1]), text)


class ExitCode(IntEnum):
    """Exit code of an `occlog` command; 0 is success."""

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
    """Base class of the errors that occlog raises on purpose.

    Attributes:
        exit_code: exit code of a command that ends with this error.
        default_id: id of errors of this class that are raised without one.
    """

    exit_code: ExitCode = ExitCode.BAD_INPUT
    default_id = "invalid-value"

    def __init__(self, message: str = "", *, id: str | None = None) -> None:
        """Create an error.

        Args:
            message: fault in one line.
            id: one of `occlog.records.error_ids.ERRORS`; None: that of the error that caused it (`raise ... from`),
                otherwise that of the class.
        """
        super().__init__(message)
        self._id = id

    @property
    def id(self) -> str:
        """Stable id of the kind of error, for example `missing-column`; docs/reference/errors.md lists all."""
        cause = self.__cause__
        if self._id is None and isinstance(cause, OcclogError) and cause is not self:
            return cause.id
        return self._id or self.default_id

    def __str__(self) -> str:
        """Return the message with options spelled for the surface in use."""
        return spelled(super().__str__())

    @property
    def options(self) -> tuple[str, ...]:
        """Names of the request's fields in the message, in order; the first is the one at fault."""
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
    """A file lacks the required scene; the command line adds how to give one.

    Attributes:
        where: the file.
    """

    def __init__(self, where: object) -> None:
        """Create the error that the file `where` contains no scene."""
        super().__init__(f"{where}: holds no scene; give one with {option('scene')}", id="missing-scene")
        self.where = where


def did_you_mean(name: str, known: Iterable[str], otherwise: str = "there are", owner: str = "") -> str:
    """Return a hint for an unknown name: `did you mean 'X'?`, or the list of valid names if none is similar.

    Args:
        name: the unknown name.
        known: the valid names; a list of more than `LONGEST_LIST` characters is cut.
        otherwise: words before the list of valid names.
        owner: method or command that the name was given to; its own renamed options come first.
    """
    names = list(known)
    near = nearest(str(name), names, owner=owner)  # Python code may give any value
    if near:
        return f"did you mean {' or '.join(map(repr, near))}?"
    return f"{otherwise} {abridged(names)}"


def abridged(names: Iterable[object]) -> str:
    """Return names separated by commas, at most `LONGEST_LIST` characters of them: `a, b and 12 more`; `none`."""
    words = [str(name) for name in names]
    text = ", ".join(words) or "none"
    if len(text) > LONGEST_LIST:
        shown = max(text[:LONGEST_LIST].count(", "), 1)
        text = f"{', '.join(words[:shown])[:LONGEST_LIST]} and {len(words) - shown} more"
    return text


def nearest(name: str, known: Iterable[str], n: int = 1, cutoff: float = 0.6, owner: str = "") -> list[str]:
    """Return the valid names most similar to an unknown one, best first; empty if none is similar.

    For a name of an earlier release its replacements are returned (`renamed.csv`), in whatever spelling it is given:
    `--sigma-v`, `sigma_v`. For a prefix such as `process_noise` it is up to three names that begin with it. A name in
    other letter case is the most similar one.

    Args:
        name: the unknown name.
        known: the valid names.
        n: largest number of names with similar spelling.
        cutoff: least similarity, 0 to 1, as `difflib` defines it.
        owner: method or command that the name was given to; replacements of its own names come first.
    """
    import difflib

    names = list(known)
    renamed = _renamed().get(_plain(name), ())
    own = [new for of, new in renamed if owner and owner in of.split(", ")]
    successors = own or [new for _, new in renamed]
    return (
        [each for each in names if each.casefold() == name.casefold()]
        or [each for each in names if _plain(each) in successors]
        or [each for each in names if _plain(each).startswith(f"{_plain(name)}_")][:3]
        or difflib.get_close_matches(name, names, n, cutoff)
    )


def _plain(name: str) -> str:
    """Return a name without dashes, `=` and spaces around it, without `no-` before it, and with `_` for `-`."""
    return name.strip("-= ").removeprefix("no-").replace("-", "_")


@functools.cache
def _renamed() -> Mapping[str, tuple[tuple[str, str], ...]]:
    """Return the public names renamed since the last release: (owner, new name) of each replacement, by old name.

    The owner is a method or table, or several with commas.
    """
    import csv
    from importlib import resources

    text = (resources.files("occlog") / "renamed.csv").read_text("utf-8")
    found: dict[str, tuple[tuple[str, str], ...]] = {}
    for row in csv.DictReader(text.splitlines()):
        found[_plain(row["old"])] = (*found.get(_plain(row["old"]), ()), (row["owner"], _plain(row["new"])))
    return found
