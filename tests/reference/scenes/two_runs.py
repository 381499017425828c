"""Two runs of three people who walk side by side, so that everything about their differences is known by hand."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.records.losses import Loss
from occlog.records.tables import PeopleTracks, Truth

STEP = 100_000_000
PEOPLE = 3
APART = 4.0
"""Distance of neighbours [m]."""
Change = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray | None]


def tracks(frames: int = 60, change: Change | None = None, start: int = 0, **more: np.ndarray) -> PeopleTracks:
    """Person k walks along y = 4 k with 1 m/s as track k + 10, but for a change.

    Args:
        frames: how many there are, 0.1 s apart.
        change: is given frame, label, x and y, which it may alter; returns which rows to keep, None: all.
        start: number of the first frame.
        more: further columns.
    """
    frame = np.repeat(np.arange(start, start + frames), PEOPLE)
    person = np.tile(np.arange(PEOPLE), frames)
    x, y, label = frame * 0.1, APART * person, person + 10
    kept = None if change is None else change(frame, label, x, y)
    rows = np.arange(len(frame)) if kept is None else np.flatnonzero(kept)
    order = rows[np.lexsort((label[rows], frame[rows]))]
    cov, none = np.full(len(frame), 0.01), np.full(len(frame), np.nan)
    columns = {"x": x, "y": y, "vx": none, "vy": none, "cov_xx": cov, "cov_xy": 0 * cov, "cov_yy": cov} | more
    values = {name: column[order] for name, column in columns.items()}
    return PeopleTracks.of(t_ns=frame[order] * STEP, target_id=label[order], **values)


def truth(frames: int = 60) -> Truth:
    """Where the three people are: their numbers are 0, 1 and 2."""
    own = tracks(frames)
    role, z = np.full(len(own), "target"), np.full(len(own), np.nan)
    return Truth.of(t_ns=own.t_ns, target_id=own.target_id - 10, role=role, x=own.x, y=own.y, z=z)


def exchanged_at(frame_of_exchange: int) -> Change:
    """Tracks 10 and 11 exchange their people from a frame on."""

    def change(frame: np.ndarray, label: np.ndarray, x: np.ndarray, y: np.ndarray) -> None:
        late = frame >= frame_of_exchange
        first, second = late & (label == 10), late & (label == 11)
        label[first], label[second] = 11, 10

    return change


def moved(person: int, first: int, last: int, by: float) -> Change:
    """Track of a person is aside in frames first to last."""

    def change(frame: np.ndarray, label: np.ndarray, x: np.ndarray, y: np.ndarray) -> None:
        y[(label == person + 10) & (frame >= first) & (frame <= last)] += by

    return change


def lost(person: int, first: int, last: int) -> Change:
    """A person is not there in frames first to last."""

    def change(frame: np.ndarray, label: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return ~((label == person + 10) & (frame >= first) & (frame <= last))

    return change


def write_run(folder: Path, table: PeopleTracks, losses: tuple[Loss, ...] = ()) -> Path:
    """A run folder that holds tracks alone."""
    folder.mkdir(parents=True, exist_ok=True)
    write_table(folder / "tracks.parquet", table, Provenance("track", losses=losses), overwrite=True)
    return folder
