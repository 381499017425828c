"""Run of `occlog ground`: read view tracks, find places in the world, write tracks, and sum up."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from occlog import console
from occlog.errors import InputError, UsageError
from occlog.io.files.provenance import Provenance, hash_inputs
from occlog.io.files.tables.table_writer import TableWriter
from occlog.io.open import load_scene, open_input
from occlog.records.declared.views import ViewTracks
from occlog.records.tables import FusedTracks
from occlog.settings import configure

from .config import STARTS, GroundConfig, in_scene
from .stage import GroundPart, ground_tracks
from .verdict import Verdict

if TYPE_CHECKING:
    from occlog.records.losses import Loss


class GroundFiles(NamedTuple):
    """Files to read and to write."""

    view_tracks: Path
    scene: Path | None
    output: Path
    overwrite: bool


def run_ground(
    files: GroundFiles, cameras: Sequence[str], values: Mapping[str, object], quiet: bool
) -> tuple[dict[str, object], tuple[Loss, ...]]:
    """Find the places and write them; return the summary, and what the view tracks say was lost."""
    view_tracks = open_input(files.view_tracks)
    if view_tracks.recording is not None:
        raise InputError(
            f"{files.view_tracks}: is a recording; give view tracks (Parquet), which `occlog track` makes from it"
        )
    scene = load_scene(files.scene, None, files.view_tracks)
    if unknown := [name for name in cameras if name not in [c.name for c in scene.cameras]]:
        raise UsageError(f"--cameras {unknown[0]}: the scene has {', '.join(c.name for c in scene.cameras) or 'none'}")
    made = _as_tracked(view_tracks.provenance)
    config = in_scene(configure(GroundConfig(), {**made, **values}), scene)
    inputs = [path for path in (files.view_tracks, files.scene) if path is not None]
    parameters = {**asdict(config), "cameras": list(cameras)}
    provenance = Provenance("ground", parameters, None, hash_inputs(inputs), view_tracks.losses)
    summary, unit = GroundSummary(), scene.length_unit
    rows = console.progress(view_tracks.rows(ViewTracks), "ground", quiet=quiet)
    with TableWriter(files.output, FusedTracks, provenance, overwrite=files.overwrite, length_unit=unit) as writer:
        for part in ground_tracks(rows, scene, config, cameras):
            writer.write(part.tracks)
            summary.add(part)
        summary.check(str(files.view_tracks))
    for line in summary.verdict.warnings():
        console.note(f"warning: {line}", quiet)
    return {"tracks": str(files.output), **summary.summary()}, view_tracks.losses


def _as_tracked(made: Provenance) -> dict[str, object]:
    """Settings that follow from how the view tracks were made; without such parameters they have none."""
    window, births = made.parameters.get("window_ns", 0), made.parameters.get("births", "")
    return {
        "window_s": window * 1e-9 if isinstance(window, int) and window >= 0 else 0.0,
        "exchange_start": STARTS.get(str(births), 0.0),
    }


class GroundSummary:
    """Figures of the summary, counted while streaming."""

    def __init__(self) -> None:
        """Begin with all counts at 0."""
        self.counts: Counter[str] = Counter()
        self.targets: dict[int, None] = {}
        self.verdict = Verdict()

    def add(self, part: GroundPart) -> None:
        """Count some more rows."""
        self.verdict.add(part)
        self.counts.update(part.counts)
        self.targets.update(dict.fromkeys(part.tracks.target_id.tolist()))

    def check(self, where: str) -> None:
        """Raise InputError where no target has a place at any time: no later command could use the tracks."""
        if not self.counts["times"]:
            raise InputError(f"{where}: has no rows of these cameras; nothing can be brought together")
        if not self.targets:
            raise InputError(
                f"{where}: no target has a place at any time ({self._why()}); targets need the same identity in two "
                "views with poses, or a height (--set height=)"
            )

    def _why(self) -> str:
        """Reasons for times without a place, with their numbers."""
        return ", ".join(f"{k.replace('_', ' ')} {n}" for k, n in self._no_place().items() if n)

    def _no_place(self) -> dict[str, int]:
        """Times without a place, by the reason."""
        return {name: self.counts[name] for name in ("one_view", "parallel", "behind", "contradict")}

    def summary(self) -> dict[str, object]:
        """The figures of the summary.

        times: of targets with a tracker in some view.  views: places by the number of views that made them.
        left_out: views that did not agree with the others.  no_place: times without a place, and why.
        The rest is of `Verdict`.
        """
        views = {k.removeprefix("views_"): n for k, n in sorted(self.counts.items()) if k.startswith("views_")}
        return {
            "targets": sorted(self.targets),
            "times": self.counts["times"],
            "rows": sum(views.values()),
            "views": views,
            "left_out": self.counts["left_out"],
            "no_place": self._no_place(),
            **self.verdict.figures(),
        }
