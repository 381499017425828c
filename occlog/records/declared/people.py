"""Tables of multi-person trackers: tracks on the ground plane, associated boxes, events.

Conventions: see `tables`.

Also tables of appearance by viewing angle, and of re-identified people ([Lee] Sec. 5.2.1).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from occlog.array_types import Bools, Floats, Ints, Ints32, Strings
from occlog.errors import InputError
from occlog.records.columns import ColumnTable, column

from .tracks import Tracks
from .views import ViewTracks

KINDS = ("initiated", "terminated", "possible_switch", "reidentified")
"""`kind` of an event."""
BOX, GROUND, PREDICTED = "box", "ground", "predicted"
"""`likelihood_mode` of a row of all people in the images: the camera has a box of the person, or the position on the
ground alone; without a calibration: the boxes of other frames alone."""
COASTING, SINGLE_VIEW, POSSIBLE_SWITCH, INCONSISTENT_VIEWS = (
    "coasting",
    "single_view",
    "possible_switch",
    "inconsistent_views",
)
"""Words of the column `quality_flags`, in the order of the column."""


def words_of(mask: Bools, words: Sequence[str]) -> Strings:
    """(N,) texts, each the words set in a row of the mask (N, W), separated by commas; `words` names the W columns."""
    different, which = np.unique(mask, axis=0, return_inverse=True)
    texts = [",".join(w for w, has in zip(words, row, strict=True) if has) for row in different.tolist()]
    return np.array(texts, dtype=np.str_)[which.reshape(-1)]


def has_word(texts: Strings, word: str) -> Bools:
    """(N,) mask of the texts (N,), lists of words separated by commas, that contain the given word."""
    different, which = np.unique(texts, return_inverse=True)
    there = np.array([word in text.split(",") for text in different.tolist()], dtype=np.bool_)
    found: Bools = there[which]
    return found


@dataclass(frozen=True, slots=True, eq=False)
class PeopleTracks(Tracks):
    """Tracks of all people on the ground plane: `Tracks` with existence probability, body size and quality flags.

    Every command reads them as `Tracks`.
    """

    existence_probability: Floats = column("probability that the person is there", nan="not known", optional=True)
    height: Floats = column("of the person", "m", nan="not known", optional=True)
    width: Floats = column("of the person, seen from any side", "m", nan="not known", optional=True)
    sd_height: Floats = column("standard deviation of the height", "m", nan="not known", optional=True)
    sd_width: Floats = column("standard deviation of the width", "m", nan="not known", optional=True)
    seen_by: Strings = column(
        "cameras with a box that is more likely of this person than not, separated by commas", optional=True
    )
    quality_flags: Strings = column(
        "why the row is not reliable, separated by commas; empty: no reason was found. `coasting` (no camera has a "
        "box of the person at this time: the position is predicted), `single_view` (one camera alone), "
        "`possible_switch` (the possible identity switch at this time; `events` has the other identity)",
        optional=True,
    )


@dataclass(frozen=True, slots=True, eq=False)
class JoinedTracks(PeopleTracks):
    """Tracks fused over several groups of cameras that were tracked separately; every command reads them as `Tracks`.

    In addition to the flags of `PeopleTracks`, `quality_flags` has `inconsistent_views` where two groups have the
    person at positions that contradict each other at this time.
    """

    source_ids: Strings = column(
        "identities in the inputs, in their order, separated by commas; `-`: not there", optional=True
    )


@dataclass(frozen=True, slots=True, eq=False)
class PeopleViews(ViewTracks):
    """All tracks projected into every image, including occluded ones; every command reads them as `ViewTracks`.

    `likelihood_mode` is `box` where the camera has a box of the person: the ellipse is inscribed in a mean of that box
    and of the box predicted from the position on the ground, weighted by the visibility. It is `ground` where only the
    predicted box is known. Without a calibration (method `sort`) the ellipse is inscribed in the estimated box, and the
    mode is `predicted` where the frame has no box of the person.
    """

    visibility: Floats = column(
        "probability that the person is visible, not occluded by other people or static occluders",
        nan="not known",
        optional=True,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Associations(ColumnTable):
    """Detection-to-track associations with probabilities: a row for each pair of a box and a track it may belong to.

    The probabilities of one box sum to at most 1; the rest is the probability that it is a false alarm or of a person
    without a track.
    """

    NAME: ClassVar[str] = "associations"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "target_id", "sensor", "box")

    t_ns: Ints = column("time of the row of `tracks` since the Unix epoch", "ns")
    target_id: Ints32 = column("identity of the track")
    sensor: Strings = column("name of the camera in the scene")
    frame: Ints = column("number of the frame in the camera's stream, from 0")
    box: Ints32 = column("number of the box in the frame: `box` of `boxes`, or `cluster` of `views`")
    probability: Floats = column("that the box is of this person, above 0 and at most 1")

    def check(self) -> None:
        """InputError unless probabilities are above 0 and at most 1."""
        bad = ~((self.probability > 0.0) & (self.probability <= 1.0))
        self.refuse(bad, "probability {probability:g} must be above 0 and at most 1")


@dataclass(frozen=True, slots=True, eq=False)
class Events(ColumnTable):
    """Track initiation, termination, possible identity switches and re-identification of a multi-person tracker."""

    NAME: ClassVar[str] = "events"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "target_id")

    t_ns: Ints = column("time since the Unix epoch", "ns")
    target_id: Ints32 = column("identity of the track")
    kind: Strings = column(
        "`initiated`, `terminated`, `possible_switch` (the identity may have been exchanged with another one) or "
        "`reidentified` (this person of the gallery from here on)"
    )
    other_id: Ints32 = column("possible_switch: the other identity, -1: of a person who has no track; else -1")
    probability: Floats = column(
        "initiated, terminated: existence probability; possible_switch: that the two were exchanged; reidentified: "
        "that it is this person",
        nan="not known",
    )

    def shares(self) -> Floats:
        """Return (N,) the share of an event that a row stands for: 1/2 in the two rows of a switch of two tracks."""
        return np.where((self.kind == "possible_switch") & (self.other_id >= 0), 0.5, 1.0)

    def counts(self) -> dict[str, float]:
        """Return the number of events by kind; a possible switch of two tracks has two rows, and counts once."""
        kinds, which = np.unique(self.kind, return_inverse=True)
        numbers = np.bincount(which, weights=self.shares(), minlength=len(kinds))
        return dict(zip(kinds.tolist(), numbers.tolist(), strict=True))

    @classmethod
    def of_rows(cls, rows: Iterable[tuple[int, str, int, int, float]]) -> Self:
        """Build the table, sorted by time and identity, from rows in any order.

        A row is (time [ns], kind, identity, other identity or -1, probability or NaN), as the columns of the table.
        """
        listed = sorted(rows, key=lambda row: (row[0], row[2]))
        if not listed:
            return cls.empty()
        t_ns, kind, target, other, probability = zip(*listed, strict=True)
        return cls.of(
            t_ns=np.array(t_ns, dtype=np.int64),
            target_id=np.array(target, dtype=np.int32),
            kind=np.array(kind, dtype=np.str_),
            other_id=np.array(other, dtype=np.int32),
            probability=np.array(probability, dtype=np.float64),
        )

    def check(self) -> None:
        """InputError unless kinds are among `KINDS`."""
        self.refuse(~np.isin(self.kind, KINDS), f"kind {{kind!r}} must be one of {', '.join(KINDS)}")


MAX_BINS = 256
"""Greatest number m of bins of a histogram of colours ([Lee] Sec. 5.2.1)."""
SAME, OTHER, SUSPENDED = "same", "other", "suspended"
DECISIONS = (SAME, OTHER, SUSPENDED)
"""`decision` of a row of `AppearanceMatches`."""


@dataclass(frozen=True, slots=True, eq=False)
class Gallery(ColumnTable):
    """Appearance gallery: a colour histogram for each target and each viewing angle from which it was seen.

    All rows have the same number of bins and of angles, so that any two can be compared ([Lee] Sec. 5.2.1).
    """

    NAME: ClassVar[str] = "gallery"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "target_id", "angle")

    t_ns: Ints = column("time of the last frame that was learnt from, the same in all rows", "ns")
    target_id: Ints32 = column("identity of the target")
    angle: Ints32 = column(
        "number n of the viewing angle: 1 the front, `angles` the back; (n - 1) pi / (angles - 1) to either side"
    )
    angles: Ints32 = column("number N of viewing angles, at least 1; 1: all sides together")
    bins: Ints32 = column(f"number m of colours, 2 to {MAX_BINS}")
    samples: Ints32 = column("boxes that were learnt from")
    pixels: Ints = column("pixels in them that count")
    density: Floats = column(
        "share of the pixels of each colour, the first `bins` of them; 0 after these", width=MAX_BINS
    )

    def check(self) -> None:
        """InputError unless angles and bins are valid and equal in all rows, and densities sum to 1.

        Densities must be 0 beyond the bins, samples and pixels at least 1, and no target may have two rows of one
        angle.
        """
        if not len(self):
            return
        for name in ("angles", "bins"):
            values: Ints32 = getattr(self, name)
            self.refuse(
                values != values[0],
                f"{name} is {{{name}}}, but {values[0]} in the first row; it must be equal in all rows",
            )
        if not 2 <= self.bins[0] <= MAX_BINS or self.angles[0] < 1:
            raise InputError(
                f"Gallery: {self.bins[0]} bins of colour and {self.angles[0]} viewing angles; expected 2 to "
                f"{MAX_BINS} bins and 1 angle or more"
            )
        self.refuse(
            (self.target_id < 0) | (self.angle < 1) | (self.angle > self.angles),
            "target_id {target_id} must be at least 0, and angle {angle} from 1 to {angles} (angles)",
        )
        self.refuse(
            (self.samples < 1) | (self.pixels < 1),
            "learned from {samples} samples and {pixels} pixels; expected at least 1 of each",
        )
        bad = (self.density < 0).any(axis=1) | (np.abs(self.density.sum(axis=1) - 1.0) > 1e-6)
        bad |= (self.density[:, int(self.bins[0]) :] != 0).any(axis=1)
        self.refuse(
            bad,
            "invalid density (colour histogram): its values must be at least 0 with sum 1, and 0 beyond the bins",
        )
        pairs = np.column_stack([self.target_id, self.angle])
        if len(np.unique(pairs, axis=0)) < len(pairs):
            raise InputError(
                "Gallery: two rows have the same target_id and angle; keep one of them", id="duplicate-row"
            )


@dataclass(frozen=True, slots=True, eq=False)
class AppearanceMatches(ColumnTable):
    """Similarity of each box to the people of a gallery at the same viewing angle: a row per box and target."""

    NAME: ClassVar[str] = "appearance_matches"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "sensor", "box", "target_id")

    t_ns: Ints = column("time of the frame since the Unix epoch", "ns")
    sensor: Strings = column("name of the camera in the scene")
    frame: Ints = column("number of the frame in the camera's stream, from 0")
    box: Ints32 = column("number of the box in the frame: `box` of `boxes`, or `cluster` of `views`")
    track_id: Ints32 = column("identity of the track that the box is of; -1 = none")
    target_id: Ints32 = column("identity in the gallery")
    angle: Ints32 = column("number of the viewing angle, 1 (front) to N (back); 0 = not known")
    viewing_angle: Floats = column(
        "between where the person heads and the camera, 0 (front) to pi (back)", "rad", nan="not known"
    )
    pixels: Ints = column("pixels of the box that count")
    rho: Floats = column("Bhattacharyya coefficient with the target seen from this side, 0 to 1", nan="suspended")
    rho_corrected: Floats = column("the same without its bias; noise may take it above 1", nan="suspended")
    decision: Strings = column("`same`: the box is this target; `other`: it is not; `suspended`: nothing is decided")
    reason: Strings = column(
        "why nothing is decided: `angle` (the gallery does not have the target from this side), `heading` (it is not "
        "known where the person heads), `covered` (by another box), `pixels` (too few); else empty"
    )

    def check(self) -> None:
        """InputError unless decisions are known, and values match the decision.

        Rows with the decision `suspended` have a reason and NaN for `rho`; all others have no reason and `rho` from 0
        to 1.
        """
        unknown = ~np.isin(self.decision, DECISIONS)
        self.refuse(unknown, f"decision {{decision!r}} must be one of {', '.join(DECISIONS)}")
        suspended = self.decision == SUSPENDED
        with np.errstate(invalid="ignore"):
            bad = (
                (suspended != np.isnan(self.rho)) | (suspended != (self.reason != "")) | (self.rho < 0) | (self.rho > 1)
            )
        self.refuse(
            bad,
            "decision {decision!r} with rho {rho:g} and reason {reason!r}; suspended: NaN and a reason, others: 0 to 1 "
            "and none",
        )
