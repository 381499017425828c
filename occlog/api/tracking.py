"""`track` in Python: bearings, boxes, reads or video to tracks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from occlog.io.open import open_input, scene_in
from occlog.records.scene import Scene
from occlog.request import Request
from occlog.track.catalogue import form_of
from occlog.track.request import Tracking

from .call import call, check_taken
from .keywords import Setting
from .results import TrackResult
from .sources import SceneSource, Source


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
    arguments = dict(locals())
    form = form_of(method)
    own = {name: value for name, value in arguments.items() if name not in ("settings", "also", "progress")}
    check_taken(form, own, also, f"method {method}")
    return call(form, arguments, TrackResult, scene=_scene_of)


def _scene_of(request: Request) -> Scene | None:
    """Where the targets are; None: no input says it."""
    assert isinstance(request, Tracking)
    return open_input(request.bearings).scene if request.scene is None else scene_in(request.scene)
