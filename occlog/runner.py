"""Execution of a request: checks its files, opens outputs with provenance, and calls its run function."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from occlog import console
from occlog.console.collection import COLLECTION
from occlog.errors import ExitCode, InputError
from occlog.io.files.atomic import OutputGroup, check_outputs, open_output
from occlog.io.files.inputs import hash_inputs, previous_losses
from occlog.io.files.names import TABLE, check_output_name
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import TableWriter
from occlog.records.columns import ColumnTable
from occlog.records.losses import Loss
from occlog.records.tables import TABLES
from occlog.records.verdicts import Check, texts_of
from occlog.request import Request, load

T = TypeVar("T")


class JobResult(NamedTuple):
    """Result of a request.

    Attributes:
        summary: figures for the user.
        losses: input that was lost in this run.
        earlier: input that was lost when the inputs were made.
        failed: failure conditions (`--fail-if`) that are met, each as text.
        shown: returns the text to print in place of the summary, as JSON (True) or for reading (False); None: the
            summary is printed.
    """

    summary: dict[str, Any]
    losses: Sequence[Loss] = ()
    earlier: Sequence[Loss] = ()
    failed: Sequence[str] = ()
    shown: Callable[[bool], str] | None = None


def run(request: Request, *, overwrite: bool = False, quiet: bool = False) -> JobResult:
    """Execute a request, and return its result.

    Args:
        request: the request.
        overwrite: replace outputs that exist.
        quiet: print no progress and no notes.

    Raises:
        OutputExistsError: an output exists and may not be replaced.
        UsageError: an output is also an input, or options contradict each other.
        InputError: an input is missing, damaged, or states something impossible.
    """
    kind = request.kind_of_input()
    request.check_kind(kind)
    check_outputs(request.inputs, request.outputs, overwrite)
    for name, path in request.files(output=True).items():
        ending = request.file_field(name).suffix
        if ending != TABLE:
            check_output_name(path, ending)
    execute = load(request.RUN)
    COLLECTION.resume()
    try:
        done = JobResult(*execute(request, Job(request, overwrite, quiet, kind)))
    except InputError as error:
        raise _with_file(error, request) from error
    return _with_earlier(done, request.inputs)


def _with_file(error: InputError, request: Request) -> InputError:
    """Return an error with the path of the input file before its message: `a.csv: bearings: row 3: ...`.

    Stages name only tables and scenes; an error with another message is returned as it is.
    """
    noun, colon, _ = str(error).partition(": ")
    files = request.files(output=False)
    # Errors of other classes name an option or a place themselves
    if type(error) is not InputError or not (colon and files) or (noun not in TABLES and noun != "scene"):
        return error
    return InputError(f"{files.get(noun) or next(iter(files.values()))}: {error}")


def _with_earlier(done: JobResult, inputs: Iterable[Path]) -> JobResult:
    """Return the result with those losses that its inputs already recorded moved from `losses` to `earlier`."""
    if not done.losses:
        return done
    known = set(previous_losses(inputs))
    before = [loss for loss in done.losses if loss in known and loss not in done.earlier]
    return done._replace(losses=[loss for loss in done.losses if loss not in known], earlier=[*done.earlier, *before])


def exit_code(request: Request, done: JobResult, *, strict: bool) -> int:
    """Return the exit code of an executed request.

    `strict`: failed checks and minor losses also give an exit code above 0.
    """
    if done.failed:
        return ExitCode.THRESHOLD
    lost = any(strict or not loss.minor for loss in done.losses)
    code = ExitCode.LOSSY if lost else ExitCode.DONE
    always = request.JUDGED and not request.STRICT
    return console.strict_code(code, done.summary.get(request.VERDICT), strict or always)


@dataclass(frozen=True)
class Job:
    """A request in execution; its run function reads, reports and writes through it.

    Attributes:
        request: the request.
        overwrite: outputs that exist are replaced.
        quiet: no progress and no notes are printed.
        kind: kind of input, for requests that have several; otherwise empty.
    """

    request: Request
    overwrite: bool
    quiet: bool
    kind: str = ""

    def progress(self, items: Iterable[T], label: str, total: int | None = None) -> Iterator[T]:
        """Generate `items`, with a progress bar on standard error if it is a terminal and the job is not quiet.

        Args:
            items: items to generate.
            label: text before the bar.
            total: number of items; None: their length, or unknown.
        """
        return console.progress(items, label, total, quiet=self.quiet)

    def note(self, text: str) -> None:
        """Write the line `text` to standard error, unless the job is quiet."""
        console.note(text, self.quiet)

    def provenance(
        self,
        parameters: Mapping[str, object],
        losses: Iterable[Loss] = (),
        seed: int | None = None,
        inputs: Sequence[Path] | None = None,
    ) -> Provenance:
        """Return the provenance of the outputs: command, parameters, and names and SHA-256 of all inputs.

        Args:
            parameters: parameters that the outputs depend on.
            losses: input that was lost.
            seed: seed of the random numbers; None: there are none.
            inputs: files that are read; None: those of the request.
        """
        hashed = hash_inputs(self.request.inputs if inputs is None else inputs)
        return Provenance(self.request.OWNER, dict(parameters), seed, hashed, tuple(losses))

    def judged(self, provenance: Provenance, checks: Iterable[Check]) -> Provenance:
        """Return the provenance with the checks of the outputs added; print their findings unless the job is quiet."""
        made = provenance.with_checks(checks)
        console.note_findings(texts_of(made.judged, self.request.OWNER), self.quiet)
        return made

    @contextmanager
    def tables(
        self,
        provenance: Provenance,
        length_unit: str,
        wider: Mapping[str, type[ColumnTable]] | None = None,
        later: Collection[str] = (),
    ) -> Iterator[Tables]:
        """Context manager that gives the writers of the requested output tables.

        All files appear together when the block ends without an error.

        Args:
            provenance: provenance of all tables.
            length_unit: unit of lengths in the tables.
            wider: table classes with more columns than the declared ones, by field of the request.
            later: fields of tables that are not opened here, but by `Tables.open`.
        """
        with ExitStack() as stack:
            tables = Tables(self, length_unit, stack, stack.enter_context(OutputGroup()))
            for name in self.request.files(output=True):
                if name not in later:
                    tables.open(name, provenance, (wider or {}).get(name))
            yield tables


class Tables:
    """Writers of the output tables of a request, by field; `open` opens a table, `write` appends rows."""

    def __init__(self, job: Job, length_unit: str, stack: ExitStack, together: OutputGroup) -> None:
        """Create the object without open tables.

        Args:
            job: job of which the tables are outputs.
            length_unit: unit of lengths in the tables.
            stack: closes the tables at its end.
            together: output files that appear together.
        """
        self._job, self._unit, self._stack, self._together = job, length_unit, stack, together
        self._writers: dict[str, TableWriter] = {}

    def open(self, field: str, provenance: Provenance, wider: type[ColumnTable] | None = None) -> None:
        """Open the table of a request's field; nothing happens if it is not requested, or if the output is no table.

        Args:
            field: name of the request's field.
            provenance: provenance of the table.
            wider: table class with more columns than the declared one; None: the declared one.
        """
        path = self._job.request.files(output=True).get(field)
        name = self._job.request.file_field(field).table
        if path is not None and name:
            writer = TableWriter(
                path,
                wider or TABLES[name],
                provenance,
                overwrite=self._job.overwrite,
                length_unit=self._unit,
                together=self._together,
            )
            self._writers[field] = self._stack.enter_context(writer)

    def write(self, **parts: ColumnTable | None) -> None:
        """Append rows to tables, given by field of the request; None and tables that are not open are skipped."""
        for name, part in parts.items():
            if part is not None and name in self._writers:
                self._writers[name].write(part)

    def write_bytes(self, field: str, content: bytes) -> None:
        """Write the whole content of an output that is no table; the file appears together with the tables.

        `field`: name of the request's field, the file of which must be requested.
        """
        with open_output(self._job.request.files(output=True)[field], self._job.overwrite, self._together) as file:
            file.write(content)

    def annotate(self, provenance: Provenance) -> None:
        """Replace the provenance of all open tables; possible until they are closed."""
        for writer in self._writers.values():
            writer.annotate(provenance)
