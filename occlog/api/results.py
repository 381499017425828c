"""Results of API functions: tables, figures and findings, which a notebook shows."""

from __future__ import annotations

import os
import sys
import warnings
from base64 import b64encode
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from html import escape
from types import FrameType
from typing import Any

import occlog
from occlog.errors import InputError, OcclogError, abridged
from occlog.io.files.provenance import verdicts_in
from occlog.io.files.tables.parquet import read_table
from occlog.records.losses import Loss
from occlog.records.scene import Scene
from occlog.records.tables import Tracks
from occlog.records.verdicts import Verdict, distinct

from .folders import Folder
from .tables import Table, in_words

PACKAGE = os.path.dirname(occlog.__file__) + os.sep  # noqa: PTH120
"""Begin of the names of all files of this package."""


class OcclogWarning(UserWarning):
    """Warning: estimates are implausible, or input was lost; the message names cause and remedy.

    `warnings.simplefilter("error", occlog.OcclogWarning)` turns it into an error.
    """


@dataclass(frozen=True, eq=False, repr=False)
class Result:
    """Result of a function.

    Attributes:
        summary: figures of the whole run, as the command prints them with `--json`.
        tables: tables by name; `result["diagnostics"]` returns one of them.
        losses: input that was lost while reading.
        warnings: findings that question the estimates, one sentence each; they were issued as Python warnings, too.
        notes: further remarks of the command.
    """

    summary: Mapping[str, Any]
    tables: Mapping[str, Table] = field(default_factory=dict)
    losses: tuple[Loss, ...] = ()
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def plausible(self) -> bool | None:
        """True if all checks of the estimates passed, False if one failed; None: unchecked."""
        found: bool | None = self.summary.get("plausible")
        return found

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Checks and findings of each stage, in order, as stored in the tables."""
        return distinct(each for table in self.tables.values() for each in verdicts_in(table.provenance))

    @property
    def provenance(self) -> Mapping[str, Any]:
        """Provenance: command, parameters, seed, version, names and SHA-256 of the inputs."""
        return next((table.provenance for table in self.tables.values()), {})

    def __getitem__(self, name: str) -> Table:
        """Return the table `name` of the result.

        Raises:
            InputError: the result has no table of that name.
        """
        if name not in self.tables:
            raise InputError(f"the result has no table {name!r}; it has {abridged(self.tables)}", id="unknown-name")
        return self.tables[name]

    def __repr__(self) -> str:
        tables = ", ".join(f"{name} {len(table)}" for name, table in self.tables.items())
        judged = {None: "", True: "; plausible", False: "; not plausible"}[self.plausible]
        return f"<occlog {type(self).__name__}: {tables or 'no tables'}{judged}>"

    def _repr_html_(self) -> str:
        """Return HTML that a notebook shows: figures, warnings, losses and notes, and the picture if there is one."""
        shown = {k: v for k, v in self._figures().items() if v not in ({}, [], ())}
        rows = "".join(
            f"<tr><th>{escape(k.replace('_', ' '))}</th><td>{escape(in_words(v))}</td></tr>" for k, v in shown.items()
        )
        notes = [("warning", text) for text in self.warnings] + [("lost", str(loss)) for loss in self.losses]
        notes += [("note", text) for text in self.notes]
        lines = "".join(f"<li><b>{escape(kind)}</b>: {escape(text)}</li>" for kind, text in notes)
        return f"<table>{rows}</table>" + (f"<ul>{lines}</ul>" if lines else "") + self._picture()

    def _figures(self) -> Mapping[str, object]:
        """Return the entries of the summary that a notebook lists: all except the warnings."""
        return {k: v for k, v in self.summary.items() if k != "warnings"}

    def _picture(self) -> str:
        """Return the result's picture as SVG or HTML text; empty without one."""
        return ""


@dataclass(frozen=True, eq=False, repr=False)
class TrackResult(Result):
    """Tracks, with the diagnostics and other tables of the tracking method.

    Attributes:
        scene: scene in which the targets move; None: unknown.
    """

    scene: Scene | None = None

    @property
    def tracks(self) -> Table:
        """Table of the estimates: `tracks`, or `view_tracks` or `boxes` of a method that tracks in images."""
        return next(iter(self.tables.values()))

    def _picture(self) -> str:
        """Return the floor plan with the tracks as SVG text; empty without tracks in the plane."""
        if self.tracks.name != "tracks" or not len(self.tracks):
            return ""
        from occlog.report.content.model import ReportInput
        from occlog.report.drawing import house_style
        from occlog.report.page import floorplan

        table = self.tracks
        data = ReportInput(scene=self.scene, tracks=read_table(table.path, Tracks), length_unit=table.length_unit)
        try:
            with house_style():
                return str(floorplan(data).svg)
        except OcclogError:
            return ""


@dataclass(frozen=True, eq=False, repr=False)
class DetectResult(Result):
    """Bearings of targets or candidates, with the detected regions (views) that they were made from."""

    @property
    def bearings(self) -> Table:
        """Table of bearings; it includes the frames without a detection."""
        return self["bearings"]

    @property
    def views(self) -> Table:
        """Table of detected regions in the images of all frames; InputError if there is none."""
        return self["views"]


@dataclass(frozen=True, eq=False, repr=False)
class EvaluateResult(Result):
    """Figures of an evaluation.

    Attributes:
        metrics: figures by name; the end of the name is the unit (`rmse_m`), except for pure numbers (`nees`).
    """

    metrics: Mapping[str, float] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Any:
        """Return the figure or the table `name`.

        Raises:
            InputError: there is neither a figure nor a table of that name.
        """
        return self.metrics[name] if name in self.metrics else super().__getitem__(name)

    def _figures(self) -> Mapping[str, object]:
        from occlog.evaluate.results import without_per_target

        judged = {} if self.plausible is None else {"plausible": self.plausible}
        return {**without_per_target(self.metrics), **judged}


@dataclass(frozen=True, eq=False, repr=False)
class ReportResult(Result):
    """A report page.

    Attributes:
        html: the whole page, which needs no other files.
        png: picture of the main figures; None: not requested.
        markdown: text and figures of the page as Markdown; None: not requested.
    """

    html: str = ""
    png: bytes | None = None
    markdown: str | None = None

    def __repr__(self) -> str:
        return f"<occlog ReportResult: a page of {len(self.html)} characters; html, png>"

    def _repr_html_(self) -> str:
        """Return HTML that shows the page in a notebook, in its own frame without access to the notebook."""
        page = escape(self.html, quote=True)
        return f'<iframe srcdoc="{page}" sandbox="allow-scripts" style="width:100%;height:48em;border:0"></iframe>'


@dataclass(frozen=True, eq=False, repr=False)
class OverlayResult(Result):
    """Tracks drawn over images.

    Attributes:
        png: picture of one frame; None: not requested.
    """

    png: bytes | None = None

    def _picture(self) -> str:
        """Return the picture of the frame as an HTML image; empty without one."""
        if self.png is None:
            return ""
        return f'<img src="data:image/png;base64,{b64encode(self.png).decode()}" style="max-width:100%">'


def tables_in(folder: Folder, names: Iterable[str]) -> dict[str, Table]:
    """Return the tables among `names` that were written into a folder, by name; missing ones are omitted."""
    return {name: Table(path, home=folder) for name, path in folder.written(names).items()}


def sentences(notes: Iterable[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Split the notes of a command into (warnings without their prefix, other notes), each without duplicates."""
    note = list(dict.fromkeys(notes))
    mark = "warning: "
    return (
        tuple(text.removeprefix(mark) for text in note if text.startswith(mark)),
        tuple(text.removeprefix("note: ") for text in note if not text.startswith(mark)),
    )


def warn(messages: Iterable[str], losses: Iterable[Loss]) -> None:
    """Issue Python warnings at the line that called occlog: one for each message, and one for all losses together."""
    level = 1
    frame: FrameType | None = sys._getframe()
    while frame is not None and frame.f_code.co_filename.startswith(PACKAGE):
        level += 1
        frame = frame.f_back
    for text in messages:
        warnings.warn(text, OcclogWarning, stacklevel=level)
    lost = [str(loss) for loss in losses]
    if lost:
        more = f", and {len(lost) - 1} more; see losses" if len(lost) > 1 else ""
        warnings.warn(f"input was lost: {lost[0]}{more}", OcclogWarning, stacklevel=level)
