"""Run `occlog ground`: read view tracks, triangulate positions, write tracks and return the summary."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict
from typing import TYPE_CHECKING

from occlog.errors import InputError, UsageError, option
from occlog.io.open import load_scene, open_input
from occlog.records.declared.views import ViewTracks
from occlog.records.tables import FusedTracks
from occlog.runner import Job
from occlog.settings import configure

from .config import STARTS, GroundConfig, in_scene
from .request import GroundRequest
from .stage import GroundConsistency, GroundTracksPart, ground_tracks

if TYPE_CHECKING:
    from occlog.io.files.provenance import Provenance
    from occlog.records.losses import Loss


def run_ground(request: GroundRequest, job: Job) -> tuple[dict[str, object], tuple[Loss, ...]]:
    """Triangulate ground positions from the request's view tracks, and write them.

    Return the figures of the summary, and the losses recorded in the view tracks. InputError for a recording,
    UsageError for a camera that the scene does not have.
    """
    view_tracks = open_input(request.view_tracks)
    if view_tracks.recording is not None:
        raise InputError(
            f"{request.view_tracks}: is a recording; give view tracks (Parquet), which `occlog track` makes from it",
            id="wrong-content",
        )
    scene = load_scene(request.scene, None, request.view_tracks)
    if unknown := [name for name in request.cameras if name not in [c.name for c in scene.cameras]]:
        known = ", ".join(c.name for c in scene.cameras) or "none"
        raise UsageError(f"{option('cameras')} {unknown[0]}: the scene has {known}", id="unknown-sensor")
    made = _as_tracked(view_tracks.provenance)
    config = in_scene(configure(GroundConfig(), {**made, **request.settings}), scene)
    parameters = {**asdict(config), "cameras": list(request.cameras)}
    provenance, summary = job.provenance(parameters, view_tracks.losses), GroundSummary()
    rows = job.progress(view_tracks.rows(ViewTracks), "ground")
    with job.tables(provenance, scene.length_unit, {"output": FusedTracks}) as tables:
        for part in ground_tracks(rows, scene, config, request.cameras):
            tables.write(output=part.tracks)
            summary.add(part)
        summary.check(str(request.view_tracks))
    for found in summary.verdict.findings("ground positions"):
        job.note(f"warning: {found.text}")
    return {"tracks": str(request.output), **summary.summary()}, view_tracks.losses


def _as_tracked(made: Provenance) -> dict[str, object]:
    """Return the settings of `ground` that follow from how the view tracks were made (their provenance).

    `window_s` is the tracker's time window (its parameter `window_ns`), `initial_switch_probability` that of `STARTS`
    for the origin of the trackers (its parameter `births`). Each is 0 where the parameter is missing.
    """
    window, births = made.parameters.get("window_ns", 0), made.parameters.get("births", "")
    return {
        "window_s": window * 1e-9 if isinstance(window, int) and window >= 0 else 0.0,
        "initial_switch_probability": STARTS.get(str(births), 0.0),
    }


class GroundSummary:
    """Counts of one run of `occlog ground`, from which the figures of its summary are made.

    `counts`: the sum of the counters of all parts, with the keys of `GroundTracksPart.counts`. `targets`: identities
    with a position, as the keys of a dict. `verdict`: quality flags and residuals, for warnings.
    """

    def __init__(self) -> None:
        """Start with all counts at 0."""
        self.counts: Counter[str] = Counter()
        self.targets: dict[int, None] = {}
        self.verdict = GroundConsistency()

    def add(self, part: GroundTracksPart) -> None:
        """Add a part, the positions of some time steps with their counts, to the sums."""
        self.verdict.add(part)
        self.counts.update(part.counts)
        self.targets.update(dict.fromkeys(part.tracks.target_id.tolist()))

    def check(self, where: str) -> None:
        """Raise InputError if there was no row of the cameras in use, or no target has a position at any time.

        `where` names the input in the message.
        """
        if not self.counts["times"]:
            raise InputError(
                f"{where}: has no rows of the cameras in use, so that no position can be "
                f"triangulated; choose others ({option('cameras')})",
                id="empty-input",
            )
        if not self.targets:
            raise InputError(
                f"{where}: no target has a position at any time ({self._why()}); targets need the same identity in two "
                f"views with poses, or a height ({option('set.target_height')})",
                id="insufficient-data",
            )

    def _why(self) -> str:
        """Return as text why target times have no position, with counts: "single view 3, parallel 2"."""
        return ", ".join(f"{k.replace('_', ' ')} {n}" for k, n in self._not_triangulated().items() if n)

    def _not_triangulated(self) -> dict[str, int]:
        """Return the number of target times without a position, by reason.

        The keys are `single_view`, `parallel` (lines of sight nearly parallel), `behind` (a camera) and `inconsistent`
        (views contradict each other).
        """
        return {name: self.counts[name] for name in ("single_view", "parallel", "behind", "inconsistent")}

    def summary(self) -> dict[str, object]:
        """Return the figures of the summary by name.

        `targets`: sorted identities with a position. `times`: pairs of target and time with a tracker in some view.
        `rows`: positions. `views`: positions by the number of views used. `skipped`: views omitted of positions
        because they did not agree with the others. `not_triangulated`: target times without a position, by reason. In
        addition those of `GroundConsistency.figures`: rows by quality flag, targets of a single view and the mean
        squared residual.
        """
        views = {k.removeprefix("views_"): n for k, n in sorted(self.counts.items()) if k.startswith("views_")}
        return {
            "targets": sorted(self.targets),
            "times": self.counts["times"],
            "rows": sum(views.values()),
            "views": views,
            "skipped": self.counts["skipped"],
            "not_triangulated": self._not_triangulated(),
            **self.verdict.figures(),
        }
