"""Readers: a file of a format of others as named columns."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar, Protocol

from numpy.typing import ArrayLike

from occlog.settings import Settings

Columns = Mapping[str, ArrayLike]
"""Values by the name of their column, which may say the unit (`bearing_deg`, `x_cm`); all of one length.

Names and units are those that any table of another program may have.  NaN and None are cells without a value.
"""


class Reader(Protocol):
    """A reader of a file format (group `occlog.readers`)."""

    summary: ClassVar[str]  # one line for --help
    settings: ClassVar[type[Settings]]
    endings: ClassVar[tuple[str, ...]]  # of the names of such files, as (".xyz",)
    table: ClassVar[str]  # what such files hold, as `bearings`: a name of the tables of this program

    def __init__(self, settings: Settings) -> None:
        """Nothing has been read yet."""

    def read(self, path: Path) -> Columns:
        """Read a file; ValueError, which says what is wrong and where, for one that is damaged."""
