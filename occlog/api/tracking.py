"""`track` in Python: bearings, boxes, reads or video to tracks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

from occlog import console
from occlog.cli.values import parse_window
from occlog.errors import UsageError
from occlog.io.open import open_input, scene_in
from occlog.records.losses import Loss
from occlog.scans.config import MeasuredConfig
from occlog.settings import Settings
from occlog.track.apf.selection_config import SelectConfig
from occlog.track.catalogue import BEARINGS, BOXES, IMAGES, METHODS, READS, VIEW, entry, settings_of
from occlog.track.options import method_params

from .folders import Folder
from .keywords import Setting, names_of, settings_by_class
from .results import TrackResult, sentences, tables_in, warn
from .sources import Inputs, SceneSource, Source

Done: TypeAlias = tuple[Mapping[str, Any], Sequence[Loss]]
WRITTEN = ("diagnostics", "residuals", "support", "events")
"""Tables that come with the tracks where the method makes them."""
ON_REQUEST = ("calibration", "cloud", "cooperation", "view_tracks", "virtual_sensors", "world")
ARGUMENTS = (
    "scene",
    "method",
    "seed",
    "cameras",
    "without",
    "window",
    "doa",
    "occluders",
    "targets",
    "starts",
    "select",
)


def track(
    bearings: Source,
    scene: SceneSource | None = None,
    *,
    method: str = "apf",
    seed: int = 0,
    cameras: str | Sequence[str] = (),
    without: str | Sequence[str] = (),
    window: float | None = None,
    targets: Sequence[int] = (),
    starts: Sequence[Sequence[float]] = (),
    labelled_only: bool = False,
    use_recovered: bool = False,
    in_turn: float | None = None,
    measurements: Source | None = None,
    doa: Source | None = None,
    doa_labels: bool = False,
    occluders: Source | None = None,
    motion: Source | None = None,
    answer_delay: float | Source | None = None,
    select: Mapping[str, Setting] | None = None,
    initial: Source | None = None,
    detections: Source | None = None,
    fundamental: Source | None = None,
    path_loss: Source | None = None,
    sights: Source | None = None,
    gallery: Source | None = None,
    also: Sequence[str] = (),
    progress: bool = False,
    **settings: Setting,
) -> TrackResult:
    """Estimate tracks of targets, as `occlog track` does.

    Args:
        bearings: bearings, or what else the method takes: boxes, reads of tags, a recording with video.
        scene: where the sensors are; None: the recording holds it.
        method: name of the tracking method.
        seed: of all random numbers; the same inputs, settings and seed give the same tracks.
        cameras: use only these sensors; empty: all.
        without: leave these sensors out.
        window: measurements this close together in time [s] make one scan; None: equal times; frames: below half the
            shortest frame period; reads: 1 s.
        targets: track only these; empty: all.
        starts: where targets are at first, each x, y and perhaps sigma.
        labelled_only: do not use candidates that are not assigned to a target.
        use_recovered: use what the fusion of detections recovered as if it had been measured.
        in_turn: use one sensor at a time, each for so long [s]; None: all at once.
        measurements: ranges, signal strengths and time differences to use too.
        doa: directions of arrival to use too; None: those of the recording.
        doa_labels: identities in the log of directions are those of targets.
        occluders: where moving occluders may be.
        motion: how targets move, a file of `occlog fit-motion`.
        answer_delay: cameras' answers take so long [s], or as the delays of `occlog traffic` say.
        select: choose cameras: `{"policy": "greedy", "count": 3}` and the other settings of the selection.
        initial: where targets are in each view at first, for methods in images.
        detections: boxes that trackers in images begin from.
        fundamental: file of fundamental matrices.
        path_loss: file of `occlog fit-readers`.
        sights: bearings of cameras that refine the tracks of tags.
        gallery: how people look, for the tracks of everybody: a table or a file of `occlog appearance learn`.
        also: more tables of the method: calibration, cloud (its particles), cooperation, view_tracks, virtual_sensors,
            world.
        progress: show a bar on standard error, if it is a terminal.
        **settings: of the method and of measurements of distances, by the names that `--set` takes or of options, in
            their units (angles in radians).

    Returns:
        The tracks, with diagnostics and the other tables that the method makes.

    Raises:
        UsageError: an argument or a setting that the method does not have, or arguments that contradict each other.
        SettingError: a setting out of its range.
        InputError: an input is missing, damaged, or says something that cannot be.

    Warns:
        OcclogWarning: the estimates are not plausible, or input was lost.
    """
    entry(method)
    sources = {
        "measurements": measurements,
        "doa": doa,
        "occluders": occluders,
        "motion": motion,
        "initial": initial,
        "detections": detections,
        "fundamental": fundamental,
        "path_loss": path_loss,
        "sights": sights,
        "gallery": gallery,
    }
    more = {
        "targets": tuple(targets),
        "starts": tuple(",".join(str(number) for number in start) for start in starts),
        "labelled_only": labelled_only,
        "use_recovered": use_recovered,
        "turn": in_turn,
        "doa_labels": doa_labels,
        "answer_delay": answer_delay,
        "policy": select,
    }
    _check_taken(method, {**sources, **more}, also)
    classes: list[tuple[str, type[Settings]]] = [
        ("", settings_of(method)),
        *([("", MeasuredConfig)] if "measurements" in entry(method).takes else []),
    ]
    values, *of_distances = settings_by_class(method, settings, classes, ARGUMENTS)
    home = Folder()
    wanted = {name: home.file(f"{name}.parquet") for name in (*WRITTEN, *also) if name in entry(method).takes}
    with Inputs() as inputs, console.notes_kept() as notes:
        measured_path, scene_path = inputs.rows(bearings, "bearings"), inputs.scene(scene)
        files = {name: inputs.optional(value, name) for name, value in sources.items()}
        if answer_delay is not None and not isinstance(answer_delay, float | int):
            more["answer_delay"] = inputs.rows(answer_delay, "answer_delay")
        asked = _Asked(
            measured=measured_path,
            shared={
                "scene": scene_path,
                "method": method,
                "settings": values,
                "only": names_of(cameras),
                "without": names_of(without),
                "seed": seed,
            },
            window_ns=None if window is None else parse_window(window),
            files=files,
            more={**more, "measured": of_distances[0] if of_distances else {}},
            wanted=wanted,
            quiet=not progress,
        )
        tracks = home.file("view_tracks.parquet" if METHODS[method].images else "tracks.parquet")
        summary, losses = _RUNS[entry(method).takes_in](asked, tracks)
        where = open_input(measured_path).scene if scene_path is None else scene_in(scene_path)
        said = [inputs.named(text) for text in notes]
    told, rest = sentences(said)
    warn(told, losses)
    return TrackResult(
        summary=home.without_paths(summary),
        tables=tables_in(home, [tracks.stem, *wanted]),
        losses=tuple(losses),
        warnings=told,
        notes=rest,
        scene=where,
    )


@dataclass(frozen=True)
class _Asked:
    """What is to be tracked, and how.

    Attributes:
        measured: bearings, boxes, reads or video.
        shared: fields that the requests of all methods have.
        window_ns: measurements this close together make one scan; None: not given.
        files: other inputs, by the names of arguments.
        more: other arguments.
        wanted: tables beside the tracks, by name.
        quiet: no progress is shown.
    """

    measured: Path
    shared: Mapping[str, Any]
    window_ns: int | None
    files: Mapping[str, Path | None]
    more: Mapping[str, Any]
    wanted: Mapping[str, Path]
    quiet: bool

    def tables(self, *names: str) -> dict[str, Path | None]:
        """Where these tables are written; None: they are not."""
        return {name: self.wanted.get(name) for name in names}


def _from_bearings(asked: _Asked, tracks: Path) -> Done:
    from occlog.track.run import TrackFiles, TrackRequest, run_track

    more = asked.more
    request = TrackRequest(
        bearings=asked.measured,
        doa=asked.files["doa"],
        starts=more["starts"],
        targets=more["targets"],
        unlabelled=not more["labelled_only"],
        window_ns=asked.window_ns or 0,
        occluders=asked.files["occluders"],
        selection=_selection(more["policy"]),
        doa_labels=more["doa_labels"],
        turn_s=more["turn"],
        motion=asked.files["motion"],
        use_recovered=more["use_recovered"],
        answer_delay=more["answer_delay"],
        measurements=asked.files["measurements"],
        measured=more["measured"],
        path_loss=asked.files["path_loss"],
        **asked.shared,
    )
    files = TrackFiles(tracks, **asked.tables("diagnostics", "calibration", "cloud", "cooperation", "residuals"))
    return run_track(request, files, False, asked.quiet)


def _from_boxes(asked: _Asked, tracks: Path) -> Done:
    from occlog.track.people.inputs import PeopleRequest
    from occlog.track.people.run import PeopleFiles, run_track_people

    request = PeopleRequest(
        boxes=asked.measured,
        doa=asked.files["doa"],
        window_ns=asked.window_ns,
        gallery=asked.files["gallery"],
        **asked.shared,
    )
    files = PeopleFiles(tracks, **asked.tables("support", "events", "view_tracks"))
    return run_track_people(request, files, False, asked.quiet)


def _from_boxes_of_one_camera(asked: _Asked, tracks: Path) -> Done:
    from occlog.track.single_view.run import SingleViewRequest, run_track_single_view

    if asked.window_ns is not None:
        raise UsageError(
            f"window: method {asked.shared['method']} takes each frame of a camera by itself; leave it out"
        )
    request = SingleViewRequest(boxes=asked.measured, **asked.shared)
    return run_track_single_view(request, tracks, False, asked.quiet)


def _from_reads(asked: _Asked, tracks: Path) -> Done:
    from occlog.track.readers.inputs import ReadsRequest
    from occlog.track.readers.run import ReadsFiles, run_track_reads

    request = ReadsRequest(
        reads=asked.measured,
        targets=asked.more["targets"],
        window_ns=asked.window_ns,
        path_loss=asked.files["path_loss"],
        sights=asked.files["sights"],
        **asked.shared,
    )
    return run_track_reads(request, ReadsFiles(tracks, **asked.tables("virtual_sensors")), False, asked.quiet)


def _from_images(asked: _Asked, tracks: Path) -> Done:
    from occlog.track.images.run.inputs import ViewsRequest
    from occlog.track.images.run.run import ViewsOutputs, run_track_views

    request = ViewsRequest(
        recording=asked.measured,
        initial=asked.files["initial"],
        detections=asked.files["detections"],
        fundamental=asked.files["fundamental"],
        window_ns=asked.window_ns,
        **asked.shared,
    )
    return run_track_views(request, ViewsOutputs(tracks, **asked.tables("world")), False, asked.quiet)


_RUNS: Mapping[str, Callable[[_Asked, Path], Done]] = {
    BEARINGS: _from_bearings,
    BOXES: _from_boxes,
    READS: _from_reads,
    VIEW: _from_boxes_of_one_camera,
    IMAGES: _from_images,
}
"""What is called for each kind of measurements."""


def _check_taken(method: str, given: Mapping[str, object], also: Sequence[str]) -> None:
    """UsageError for an argument or a table that the method does not have."""
    takes = {param.name for param in method_params(method)}
    for name, value in given.items():
        if not (value is None or value is False or (isinstance(value, tuple) and not value)) and name not in takes:
            said = {"turn": "in_turn", "policy": "select"}.get(name, name)
            raise UsageError(f"{said} is not an argument of method {method}; leave it out")
    for name in also:
        if name not in ON_REQUEST or name not in takes:
            known = ", ".join(n for n in ON_REQUEST if n in takes) or "none"
            raise UsageError(f"also: method {method} has no table {name!r} on request; it has: {known}")


def _selection(select: Mapping[str, Setting] | None) -> Mapping[str, object]:
    if select is None:
        return {}
    (found,) = settings_by_class("select", select, [("", SelectConfig)], ())
    return found
