"""What is known of all rows of tables of which a part is drawn: every number that a page says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from occlog.array_types import Floats, Ints
from occlog.records.verdicts import Check

from .beside_bound import BesideBound
from .fared import Fared
from .looks import Looked
from .off_sight import Distances, Residual
from .people import People
from .selections import Selections
from .thinned import ErrorsSoFar, Whole


@dataclass(frozen=True, eq=False)
class OfAll:
    """Figures of all rows; None of tables that are not given, or say nothing.

    Attributes:
        whole: of each table that is given, by its name.
        moments: (M,) times that the replay shows; None: nothing moves.
        every: of all times of what moves each so manieth is one of these.
        sight_every: each so manieth moment has sight lines.
        priors_every: each so manieth moment has occluders as the tracker knew them.
        errors: of all errors.
        errors_so_far: (N,) RMSE of the target of each error that is drawn, up to it.
        bound: of errors beside the bound.
        bound_so_far: (N, 2) root mean square of each bound that is drawn and of all before it, and of smoothing.
        looked: of all bearings.
        residuals: of each track.
        sight: distances of each track whose errors are not known.
        people: of all estimates of everybody; None: tracks are not of everybody.
        fared: of all diagnostics.
        deviation: median standard deviation of a position.
        selections: of each target for which cameras were selected.
        events: how many there are of each kind.
        judged: what was checked of the tracks; None: nothing was.
    """

    whole: Mapping[str, Whole] = field(default_factory=dict)
    moments: Ints | None = None
    every: int = 1
    sight_every: int = 1
    priors_every: int = 1
    errors: ErrorsSoFar | None = None
    errors_so_far: Floats | None = None
    bound: BesideBound | None = None
    bound_so_far: Floats | None = None
    looked: Looked | None = None
    residuals: Mapping[int, Residual] = field(default_factory=dict)
    sight: Mapping[int, Distances] = field(default_factory=dict)
    people: People | None = None
    fared: Fared | None = None
    deviation: float = float("nan")
    selections: Mapping[int, Selections] = field(default_factory=dict)
    events: Mapping[str, int] = field(default_factory=dict)
    judged: tuple[Check, ...] | None = None
