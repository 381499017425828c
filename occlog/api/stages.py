"""Functions of the Python API that run a stage, as the commands of the same names do.

`detect`, `fuse` and `label` lead from images to bearings with identities; `ingest` and `simulate` make a recording;
`track` estimates tracks, `evaluate` compares them with the truth; `report` and `overlay` show them.
"""

from __future__ import annotations

import operator
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, SupportsIndex, TypeAlias

from occlog.errors import UsageError
from occlog.evaluate.request import EvaluateRequest
from occlog.ingest.plan import is_name
from occlog.ingest.request import IngestRequest
from occlog.io.open import open_input, scene_in
from occlog.measure.associate.request import LabelRequest
from occlog.measure.detect.request import ONNX
from occlog.measure.detect.request import VERB as DETECT_VERB
from occlog.measure.fuse.request import FuseRequest, TrackFusionRequest
from occlog.records.scene import Scene
from occlog.report.request import OverlayRequest, PageRequest, ReportRequestBase
from occlog.request import Form, Request
from occlog.settings import read_pair
from occlog.simulate.request import VERB as SIMULATE_VERB
from occlog.track.catalogue import VERB as TRACK_VERB
from occlog.track.catalogue import form_of, method_for
from occlog.track.request import TrackRequestBase

from .call import Setting, call, check_taken, names_of, record
from .recordings import Recording, SceneSource, Source, path_of
from .results import DetectResult, EvaluateResult, OverlayResult, ReportResult, TrackResult
from .tables import Table


def detect(
    recording: Source,
    *,
    scene: SceneSource | None = None,
    cameras: str | Sequence[str] = (),
    target: Source | None = None,
    target_boxes: Sequence[str] = (),
    track_feedback: Source | None = None,
    learn_background: bool = True,
    fuse: Mapping[str, Setting] | bool = False,
    onnx: str | os.PathLike[str] | None = None,
    classes: Sequence[str] = (),
    names: str | os.PathLike[str] | None = None,
    embed: str | os.PathLike[str] | None = None,
    bearings: bool = False,
    method: str | None = None,
    workers: int | None = None,
    progress: bool = False,
    **settings: Setting,
) -> DetectResult:
    """Detect people in the frames of a recording, and reduce them to bearings of its targets, as `occlog detect` does.

    By default occlog's own network detects people, or background subtraction where that fits better. With `onnx`
    another network detects boxes, and with `method="NAME"` a detector of a plug-in; both result in views.

    Args:
        recording: recording with video, with boxes of a detector, or with simulated bearings.
        scene: scene with the poses of the cameras; None: that of the recording.
        cameras: use these cameras only; empty: all.
        target: file with the appearances of targets; None: those attached to the recording.
        target_boxes: boxes around targets from which their appearance is learnt, each `[ID:]CAM:FRAME:X,Y,W,H` [px].
        track_feedback: tracks around which targets are searched for.
        learn_background: learn the empty scene from the recording in a first pass.
        fuse: fuse the detections of the cameras; settings of the fusion, or True for its defaults.
        onnx: detect with this network (ONNX).
        classes: with `onnx`: classes to detect, by name or number; empty: people, or the only class.
        names: with `onnx`: file with the names of its classes, one per line.
        embed: network (ONNX) that computes an appearance vector for each detected box.
        bearings: with `onnx` or a plug-in: also compute a candidate bearing for each box.
        method: `network` (that of occlog), `background`, `outlines` or `components` (background subtraction), `auto` (a
            choice between network and background subtraction), or the name of a plug-in's detector; None: auto.
        workers: number of threads, which does not change the result; None: one per processor.
        progress: show a bar on standard error, if it is a terminal.
        **settings: settings of the detection, the network or the plug-in, by the names and in the units of
            docs/reference/settings.md.

    Returns:
        Bearings of the targets or candidates, and as views every box or region of the size of a person.

    Raises:
        UsageError: an unknown setting, or arguments that contradict each other.
        InputError: an input is missing, damaged, or states something impossible.
        PluginError: a plug-in fails.

    Warns:
        OcclogWarning: frames were lost, or the world seems not to be upright.
    """
    arguments = dict(locals())
    arguments |= {"bearings": bearings or None, "fuse": fuse is not False}
    kind = ONNX if onnx is not None else method or DETECT_VERB.default
    form = DETECT_VERB.form(kind)
    own = {name: value for name, value in arguments.items() if name not in ("settings", "progress")}
    check_taken(form, {**own, "learn_background": not learn_background}, (), f"detector {kind}", DETECT_VERB, settings)
    return call(form, {**arguments, "fusion": fuse}, DetectResult)


def fuse(
    bearings: Source,
    *,
    views: Source | None = None,
    scene: SceneSource | None = None,
    **settings: Setting,
) -> DetectResult:
    """Fuse the detections of several cameras, as `occlog fuse` does: remove false ones, recover missed ones.

    Args:
        bearings: detections of targets, or candidates.
        views: regions in the images that the bearings were made from.
        scene: scene with the poses of the cameras; None: that of the input.
        **settings: settings of the fusion, by their names in docs/reference/settings.md.

    Returns:
        The fused bearings, and the fused views if `views` is given.

    Raises:
        UsageError: an unknown setting.
        InputError: an input is missing or damaged, or cannot be fused.

    Warns:
        OcclogWarning: input was lost, or the fusion is unreliable.
    """
    return call(Form(FuseRequest), locals(), DetectResult)


def fuse_tracks(tracks: Sequence[Source | TrackResult], **settings: Setting) -> TrackResult:
    """Fuse the tracks of several groups of cameras, as `occlog fuse --with` does: one track and identity per person.

    Args:
        tracks: tracks of each group, two or more groups, all in one world frame.
        **settings: settings of the fusion of tracks, by their names in docs/reference/settings.md.

    Returns:
        The fused tracks; the table `events` has track initiations, terminations and possible identity switches.

    Raises:
        UsageError: an unknown setting, or fewer than two groups.
        InputError: an input is missing, damaged, or in another unit.

    Warns:
        OcclogWarning: input was lost, or the groups contradict each other.
    """
    if isinstance(tracks, str | bytes) or not isinstance(tracks, Sequence) or len(tracks) < 2:
        raise UsageError("fuse_tracks: give the tracks of two or more groups of cameras in a list", id="missing-option")
    first, *others = (each.tracks if isinstance(each, TrackResult) else each for each in tracks)
    arguments = {"bearings": first, "others": others, "settings": settings}
    names = {f"others[{index - 1}]" if index else "bearings": f"tracks[{index}]" for index in range(len(tracks))}
    found = call(Form(TrackFusionRequest), arguments, TrackResult, names)
    known = [Path(t).name if isinstance(t, str | os.PathLike) else f"tracks[{k}]" for k, t in enumerate(tracks)]
    if len(set(known)) < len(known):
        return found
    groups = dict(zip(known, found.summary["groups"].values(), strict=True))
    return replace(found, summary={**found.summary, "groups": groups})


def label(
    bearings: Source,
    tracks: Source,
    *,
    scene: SceneSource | None = None,
    doa: Source | None = None,
    doa_labels: bool = False,
    cameras: str | Sequence[str] = (),
    without: str | Sequence[str] = (),
    **settings: Setting,
) -> DetectResult:
    """Assign identities of tracks to candidates by their bearings, as `occlog label` does.

    Args:
        bearings: candidates, or a recording that contains them.
        tracks: tracks that provide the identities.
        scene: scene with the poses of the sensors; None: that of the recording.
        doa: directions of arrival to label, too.
        doa_labels: the identities in the log of directions are those of targets.
        cameras: use these sensors only; empty: all.
        without: exclude these sensors.
        **settings: settings of the association, by their names in docs/reference/settings.md.

    Returns:
        The bearings with identities.

    Raises:
        UsageError: an unknown setting.
        InputError: an input is missing or damaged, or no track covers the time of any frame.

    Warns:
        OcclogWarning: input was lost.
    """
    return call(Form(LabelRequest), locals(), DetectResult)


JUDGED = ("plausible", "warnings")
"""Entries of a summary other than figures."""


def evaluate(
    tracks: Source | TrackResult | None = None,
    truth: Source | None = None,
    *,
    bearings: Source | None = None,
    doa: Source | None = None,
    doa_labels: bool = False,
    truth_azimuths: Source | None = None,
    doa_gate_deg: float | None = None,
    measurements: Source | None = None,
    views: Source | None = None,
    cooperation: Source | None = None,
    diagnostics: Source | None = None,
    scene: SceneSource | None = None,
    frames: tuple[int, int] | None = None,
    also: tuple[str, ...] = (),
    metrics: Sequence[str] | Mapping[str, Mapping[str, Setting]] = (),
    **settings: Setting,
) -> EvaluateResult:
    """Compare tracks with the truth, the Cramer-Rao bound and the bearings that they were made from.

    This is `occlog evaluate`: every figure that the given inputs allow is computed.

    Args:
        tracks: tracks in the world or in images; a result of `track` also provides its diagnostics.
        truth: true positions or boxes.
        bearings: bearings, for detection rates, the bound and the residuals of lines of sight.
        doa: directions of arrival to use in addition to the bearings.
        doa_labels: the identities in the log of directions are those of targets.
        truth_azimuths: true directions of arrival, with which only `doa` is compared.
        doa_gate_deg: largest angle between a direction and the true one [deg]; beyond it the direction is false, and
            the true one missed; None: 10.
        measurements: ranges, signal strengths and time differences, for the bound.
        views: views to compare with true boxes; with `held_out`, views or boxes of all people.
        cooperation: requests of `track` to cameras; their numbers and mean period are reported.
        diagnostics: filter diagnostics of `track`, for the consistency checks.
        scene: scene with the poses of the sensors; None: that of the recording with the truth or the bearings.
        frames: (first, stop): only frames first <= number < stop.
        also: further tables of many targets: `failures` and `counts` (on the ground).
        metrics: names of plug-ins' metrics, or their settings by name of plug-in; for tracks on the ground with truth.
        **settings: settings by the names of the options: `match`, `held_out`, `sigma_v`, `match_distance` and others.

    Returns:
        The figures, and the tables `errors` and `bound` where they have rows.

    Raises:
        UsageError: an unknown argument or setting, or one that does not apply to these inputs.
        InputError: an input is missing, damaged, or states something impossible.

    Warns:
        OcclogWarning: the tracks are not plausible.
    """
    if isinstance(tracks, TrackResult):
        diagnostics = tracks.tables.get("diagnostics") if diagnostics is None else diagnostics
        tracks = tracks.tracks
    arguments = dict(locals())
    form = Form(EvaluateRequest)
    check_taken(form, {}, also, "evaluate")
    result = call(form, arguments, EvaluateResult)
    figures = {name: value for name, value in result.summary.items() if name not in JUDGED}
    tables = {name: table for name, table in result.tables.items() if len(table)}
    return replace(result, tables=tables, metrics=figures)


File: TypeAlias = "str | os.PathLike[str]"
Files: TypeAlias = "File | Sequence[File] | Mapping[str, File]"
"""A file or folder, several, or those of each camera or array by its name."""
Times: TypeAlias = "float | str | Mapping[str, float | str]"
"""One for all, or that of each camera or array by its name."""


def ingest(
    *bags: File,
    topic: Mapping[str, str | Sequence[str]] | None = None,
    topics: File | Sequence[File] = (),
    video: Mapping[str, File] | None = None,
    images: Mapping[str, File] | None = None,
    boxes: Files = (),
    mot: Mapping[str, File] | None = None,
    positions: Files = (),
    grid: str | None = None,
    doa: Files = (),
    reads: File | Sequence[File] = (),
    truth: Files = (),
    timestamps: Files = (),
    calibration: File | Sequence[File] = (),
    image_size: tuple[int, int] | None = None,
    scene: SceneSource | None = None,
    arrays: Files = (),
    readers: File | None = None,
    start_time: Times | None = None,
    clock_offset: Mapping[str, float | str] | None = None,
    fps: Times | None = None,
    frames: tuple[int, int] | Mapping[str, tuple[int, int]] | None = None,
    output: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
    progress: bool = False,
    **settings: Setting,
) -> Recording:
    """Make one recording from the files of cameras, microphone arrays and tag readers, as `occlog ingest` does.

    Files of cameras and arrays are a path, several paths, or a dict of paths by the sensor's name.

    Args:
        *bags: bags of ROS 2 or 1, or MCAP files of other programs, that are parts of one recording; or WILDTRACK's
            folder.
        topic: topics of a bag, by the name of the camera, array or target that each belongs to.
        topics: YAML files with such topics by name.
        video: video file of each camera.
        images: folder with the images of each camera.
        boxes: boxes of a detector.
        mot: boxes in MOTChallenge text; the same as `boxes`.
        positions: positions on the ground that detectors report, by the name of the detector.
        grid: "SIZE,X,Y" of positions that are counted in cells: size of a cell, and position of cell (0, 0).
        doa: logs of directions of arrival.
        reads: logs of radio tags that readers have read.
        truth: true positions or boxes.
        timestamps: times of the frames.
        calibration: calibration files of the cameras.
        image_size: width and height of the images [px]; a calibration that states another size is scaled.
        scene: room, occluders, arrays, and cameras that the calibration lacks.
        arrays: positions of direction finders, or of the microphones of one array.
        readers: positions and ranges of the tag readers.
        start_time: origin of the times: date and time (ISO 8601) or seconds since 1970; None: 0.
        clock_offset: offset added to the times of a sensor: seconds, or text with a unit: {"cam2": "-400ms"}.
        fps: frame rate [Hz], where nothing else gives times.
        frames: (first, stop): only frames first <= number < stop, of all cameras, or by the camera's name.
        output: path of the recording to write; None: a temporary folder, removed with the last reference to the
            recording.
        overwrite: replace an output that exists.
        progress: show a bar on standard error, if it is a terminal.
        **settings: settings by the names of the options: `calibration_unit`, `up`, `store`, `classes`,
            `allow_uncalibrated` and others.

    Returns:
        The recording. `notes` in its `summary` state how calibration and tables were understood.

    Raises:
        UsageError: an unknown setting, or arguments that contradict each other.
        InputError: an input is missing, damaged, or states something impossible.
        OutputExistsError: the output exists and may not be replaced.

    Warns:
        OcclogWarning: input was lost, or seems to differ from what it states.
    """
    if "bags" in settings:
        raise UsageError("ingest: bags are positional arguments: ingest(bag, ...)", id="unknown-key")
    if isinstance(settings.get("classes"), str | Sequence):
        settings["classes"] = names_of(settings["classes"])  # type: ignore[arg-type]
    of_sensors: dict[str, object] = {"video": video, "images": images, "boxes": boxes, "mot": mot, "doa": doa}
    of_sensors["positions"] = positions
    of_sensors |= {"truth": truth, "timestamps": timestamps, "arrays": arrays}
    of_sensors |= {"start_time": start_time, "clock_offset": clock_offset, "fps": fps}
    if not (topic is None or isinstance(topic, Mapping)):
        raise UsageError(
            f"topic: {topic!r}: expected topics by sensor: {{'cam1': '/cam1/image'}}", id="invalid-setting"
        )
    of_topics = {n: names_of(t) for n, t in (topic or {}).items()}
    arguments = {
        "bags": _paths(bags, "bags"),
        "topics": _paths(topics, "topics"),
        "reads": _paths(reads, "reads"),
        "calibration": _paths(calibration, "calibration"),
        "image_size": None if image_size is None else _pair(image_size, "image_size"),
        "scene": scene,
        "readers": readers,
        "grid": grid,
        "frames": _ranges(frames),
        "topic": tuple(text for n, each in of_topics.items() for t in each for text in _named({n: t}, "topic")),
        **{name: _named(value, name) for name, value in of_sensors.items()},
        "settings": settings,
        "output": output,
        "overwrite": overwrite,
        "progress": progress,
    }
    return record(Form(IngestRequest), arguments)


def _paths(value: File | Sequence[File], argument: str) -> tuple[Path, ...]:
    """Return a tuple of paths from one path or a sequence of paths; InputError, naming the `argument`, for others."""
    if isinstance(value, Sequence) and not isinstance(value, str | bytes):
        return tuple(path_of(each, argument) for each in value)
    return (path_of(value, argument),)


def _named(value: object, argument: str) -> tuple[str, ...]:
    """Return an argument as texts that the command accepts: `NAME=VALUE` for mappings, otherwise `VALUE`.

    Args:
        value: mapping from sensor to value, sequence of values, or one value; None: no texts.
        argument: name of the argument, for messages.

    Raises:
        UsageError: a name that no sensor can have, or a table in memory.
    """
    if value is None:
        return ()
    if isinstance(value, Mapping):
        wrong = next((name for name in value if not is_name(str(name))), None)
        if wrong is not None:
            raise UsageError(f"{argument}: {wrong!r} is no name: up to 64 characters without space, comma, / = and :")
        return tuple(f"{name}={_text(each, argument)}" for name, each in value.items())
    if isinstance(value, Sequence) and not isinstance(value, str):
        return tuple(_text(each, argument) for each in value)
    return (_text(value, argument),)


def _text(value: object, argument: str) -> str:
    """Return a value as typed on the command line: 10.0 is `10`.

    Raises:
        UsageError: the value is a table in memory; the message names the argument.
    """
    if isinstance(value, float):
        return f"{value:.15g}"
    if getattr(value, "ndim", 0) or hasattr(value, "__arrow_c_stream__"):
        raise UsageError(
            f"{argument}: a {type(value).__name__} in memory; give a path, or pass the table itself to occlog.track"
        )
    return os.fspath(value) if isinstance(value, os.PathLike) else str(value)


def _ranges(frames: tuple[int, int] | Mapping[str, tuple[int, int]] | None) -> tuple[str, ...]:
    """Return frame ranges as texts that the command accepts: `0:100` for all cameras, `cam1=0:100` for one.

    `frames`: (first, stop), or such pairs by camera; None: no texts. Raise UsageError for other values.
    """
    each = frames if isinstance(frames, Mapping) else {} if frames is None else {"": frames}
    found = {n: _pair(p, "frames") for n, p in each.items()}
    texts = {name: f"{first}:{stop}" for name, (first, stop) in found.items()}
    return _named(texts if isinstance(frames, Mapping) else [*texts.values()], "frames")


def _pair(value: object, argument: str) -> tuple[int, int]:
    """Return (first, stop) of frames, or (width, height) of images where `argument` is `image_size`.

    `value` is a sequence of two whole numbers, or a text as on the command line; UsageError for others.
    """
    size = argument == "image_size"
    if isinstance(value, str):
        try:
            return read_pair(value, size)
        except UsageError as error:
            raise UsageError(f"{argument}: {error}") from error
    given = list(value) if isinstance(value, Iterable) else []
    numbers = [operator.index(each) for each in given if isinstance(each, SupportsIndex)]
    if len(given) == len(numbers) == 2:
        first, second = numbers
        if first > 0 < second if size else 0 <= first < second:
            return first, second
    of = "(width, height) of images, above 0" if size else "(first, stop) of frames, with 0 <= first < stop"
    raise UsageError(f"{argument}: {value!r}: expected two whole numbers {of}", id="invalid-setting")


NOT_OF_REQUESTS = ("settings", "output", "overwrite", "progress")


def simulate(
    scene: SceneSource | None = None,
    *,
    kind: Literal["balls", "people"] | None = None,
    seed: int = 0,
    seconds: float | None = None,
    rate_hz: float | None = None,
    fps: float | None = None,
    paths: Source | None = None,
    avoid: Source | None = None,
    bearings: bool | None = None,
    render: bool = False,
    workers: int | None = None,
    output: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
    progress: bool = False,
    **settings: Setting,
) -> Recording:
    """Simulate a recording with ground truth, as `occlog simulate` does.

    Args:
        scene: room and sensors; None with a `kind`, which needs none.
        kind: `balls` or `people`: a video to track in, in place of a scene.
        seed: seed of all random numbers.
        seconds: length of the recording [s], in place of `steps`.
        rate_hz: time steps per second.
        fps: frame rate of every camera [Hz].
        paths: file with scripted paths of targets (YAML), in place of random walkers.
        avoid: positions of people whom the walkers avoid, and who are not recorded.
        bearings: simulate the bearings of the cameras; None: unless there is video.
        render: add video of every camera.
        workers: number of threads, which does not change the result; None: one per processor.
        output: path of the recording to write; None: a temporary folder, removed with the last reference to the
            recording.
        overwrite: replace an output that exists.
        progress: show a bar on standard error, if it is a terminal.
        **settings: settings of walkers, cameras, arrays, readers and storage, by their names in
            docs/reference/settings.md; those of the video begin with `render_`.

    Returns:
        The recording.

    Raises:
        UsageError: an unknown setting, or arguments that contradict each other.
        InputError: the scene is missing, damaged, or states something impossible.
        OutputExistsError: the output exists and may not be replaced.
    """
    if kind is not None and scene is not None:
        raise UsageError(f"kind {kind!r} makes its own scene; leave the scene out", id="conflicting-options")
    if kind is None and scene is None:
        raise UsageError("no scene: give one, or kind='balls' or 'people'", id="missing-scene")
    arguments = dict(locals())
    chosen = kind or ("walkers" if paths is None else "paths")
    form = SIMULATE_VERB.form(chosen)
    own = {name: value for name, value in arguments.items() if name not in NOT_OF_REQUESTS}
    check_taken(form, own, (), f"kind {chosen}" if kind else "a scene", SIMULATE_VERB)
    return record(form, arguments)


def track(
    bearings: Source,
    scene: SceneSource | None = None,
    *,
    method: str | None = None,
    seed: int = 0,
    cameras: str | Sequence[str] = (),
    without: str | Sequence[str] = (),
    window: float | None = None,
    targets: Sequence[int] = (),
    initial_positions: Sequence[Sequence[float]] = (),
    labelled_only: bool = False,
    keep_labels: bool = False,
    reject_outliers: bool = False,
    use_recovered: bool = False,
    round_robin_s: float | None = None,
    measurements: Source | None = None,
    doa: Source | None = None,
    doa_labels: bool = False,
    occluders: Source | None = None,
    motion: Source | None = None,
    answer_delay: float | Source | None = None,
    select: Mapping[str, Setting] | None = None,
    initial_ellipses: Source | None = None,
    detections: Source | None = None,
    fundamental: Source | None = None,
    path_loss: Source | None = None,
    refine_bearings: Source | None = None,
    gallery: Source | None = None,
    also: Sequence[str] = (),
    progress: bool = False,
    **settings: Setting,
) -> TrackResult:
    """Estimate tracks of targets, as `occlog track` does.

    Args:
        bearings: bearings, or what else the method needs: boxes, reads of tags, a recording with video.
        scene: scene with the poses of the sensors; None: that of the recording.
        method: name of the tracking method; None: by the input, `jipda` for boxes (`sort` without a calibration),
            `virtual` for reads of tags, otherwise `apf`.
        seed: seed of all random numbers; equal inputs, settings and seeds give equal tracks.
        cameras: use these sensors only; empty: all.
        without: exclude these sensors.
        window: measurements closer together in time than this [s] make one scan; None: equal times; for frames less
            than half the shortest frame period; for reads 1 s.
        targets: identities to track; empty: all.
        initial_positions: initial position of each target: x, y and optionally its standard deviation.
        labelled_only: ignore candidates that are not assigned to a target.
        keep_labels: keep the given labels where two targets exchange theirs.
        reject_outliers: give method `fix` no bearings that contradict the motion of their target.
        use_recovered: use detections that the fusion recovered like measured ones.
        round_robin_s: use one sensor at a time, for this long each [s]; None: all sensors at once.
        measurements: further measurements: ranges, signal strengths and time differences.
        doa: directions of arrival to use in addition; None: those of the recording.
        doa_labels: the identities in the log of directions are those of targets.
        occluders: positions or priors of moving occluders.
        motion: motion model, a file of `occlog fit-motion`.
        answer_delay: latency of the cameras' answers [s], or a table of delays of `occlog traffic`.
        select: settings of the selection of cameras: `{"policy": "greedy", "count": 3}` and others.
        initial_ellipses: initial ellipses of targets in each view, for methods in images.
        detections: boxes that initiate trackers, for methods in images.
        fundamental: file with fundamental matrices.
        path_loss: path loss model of the readers, a file of `occlog fit-readers`.
        refine_bearings: bearings of cameras that refine the tracks of tags.
        gallery: appearance of people, by which lost tracks are re-identified: a table or a file of `occlog appearance
            learn`.
        also: further tables of the method: calibration, particle_cloud, cooperation, view_tracks, virtual_sensors,
            ground_tracks.
        progress: show a bar on standard error, if it is a terminal.
        **settings: settings of the method and of the measurements of distances, by the names that `--set` takes or of
            options, in their own units (angles in radians).

    Returns:
        The tracks, with diagnostics and the other tables of the method.

    Raises:
        UsageError: an argument or setting that the method does not have, or arguments that contradict each other.
        SettingError: a setting out of its range.
        InputError: an input is missing, damaged, or states something impossible.

    Warns:
        OcclogWarning: the estimates are not plausible, or input was lost.
    """
    arguments = dict(locals())
    if method is None:
        method = arguments["method"] = _method_for(bearings, scene)
    form = form_of(method)
    own = {name: value for name, value in arguments.items() if name not in ("settings", "also", "progress")}
    check_taken(form, own, also, f"method {method}")
    return call(form, arguments, TrackResult, scene=_scene_of)


def _method_for(source: Source, scene: object) -> str:
    """Return the name of the tracking method that fits the contents of `source` and of the scene.

    Files, tables and recordings are inspected; for other values it is the default method.
    """
    path, place = (each.source if isinstance(each, Table | Recording) else each for each in (source, scene))
    if not isinstance(path, str | Path):
        return TRACK_VERB.default
    return method_for(path, place if isinstance(place, str | Path) else None)


def _scene_of(request: Request) -> Scene | None:
    """Return the scene of the targets: that of the request's scene file, otherwise that of its input.

    None if missing.
    """
    assert isinstance(request, TrackRequestBase)
    return open_input(request.bearings).scene if request.scene is None else scene_in(request.scene)


SIDE_OUTPUTS = {"png": ".png", "markdown": ".md"}
"""Endings of files that are written next to a page."""


def report(
    tracks: Source | TrackResult | None = None,
    *,
    scene: SceneSource | None = None,
    truth: Source | None = None,
    bearings: Source | None = None,
    errors: Source | None = None,
    bound: Source | None = None,
    diagnostics: Source | None = None,
    events: Source | None = None,
    occluders: Source | None = None,
    metrics: str | os.PathLike[str] | None = None,
    images: Source | None = None,
    recording: Source | None = None,
    images_limit: float = 5.0,
    title: str = "Tracking report",
    png: bool = False,
    markdown: bool = False,
    output: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
) -> ReportResult:
    """Make a page that shows tracks and the other given tables, as `occlog report` does.

    Args:
        tracks: tracks; a result of `track` also provides its diagnostics and events. For tracks in images the page has
            no floor plan. None: only the scene is drawn.
        scene: room and sensors; None: those of the recording with the truth or the bearings.
        truth: true positions.
        bearings: bearings, for observation coverage and lines of sight.
        errors: table `errors` of `evaluate`.
        bound: table `bound` of `evaluate`.
        diagnostics: table `diagnostics` of `track`.
        events: table `events` of `track`: initiations, terminations and possible identity switches.
        occluders: moving occluders as the tracker was given them.
        metrics: figures written by `occlog evaluate` (JSON).
        images: recording with images, shown small next to the plan with the tracks drawn over them.
        recording: the same as `images`.
        images_limit: largest total size of the images in the page [MB]; further images are omitted.
        title: heading of the page.
        png: also make a picture of the main figures.
        markdown: also make text and figures as Markdown.
        output: path of the page to write (HTML), with picture and Markdown next to it; None: the page is only returned
            as `html`.
        overwrite: replace files that exist.

    Returns:
        The page, and the requested picture and Markdown.

    Raises:
        UsageError: there is nothing to show.
        InputError: an input is missing, damaged, or of another scene.

    Warns:
        OcclogWarning: the tracks are not plausible, or input was lost.
    """
    if isinstance(tracks, TrackResult):
        diagnostics = tracks.tables.get("diagnostics") if diagnostics is None else diagnostics
        events = tracks.tables.get("events") if events is None else events
        scene = tracks.scene if scene is None and tracks.tracks.name == "tracks" else scene
        tracks = tracks.tracks
    arguments: dict[str, Any] = dict(locals())
    if output is not None:
        arguments |= {name: Path(output).with_suffix(end) for name, end in SIDE_OUTPUTS.items() if arguments[name]}
    return call(Form(PageRequest), arguments, ReportResult, html=_page, png=_picture, markdown=_words)


def _page(request: Request) -> str:
    assert isinstance(request, PageRequest)
    assert request.output is not None
    return request.output.read_text(encoding="utf-8")


def _words(request: Request) -> str | None:
    assert isinstance(request, PageRequest)
    return None if request.markdown is None else request.markdown.read_text(encoding="utf-8")


def _picture(request: Request) -> bytes | None:
    assert isinstance(request, ReportRequestBase)
    return None if request.png is None else request.png.read_bytes()


def overlay(
    tracks: Source | TrackResult | None = None,
    *,
    recording: Source,
    truth: Source | None = None,
    failures: Source | None = None,
    fundamental: Source | None = None,
    scene: SceneSource | None = None,
    video: str | os.PathLike[str] | None = None,
    frame: int | None = None,
    frames: tuple[int, int] | None = None,
    cameras: str | Sequence[str] = (),
    scale: float | None = None,
    fps: float | None = None,
    ground_tracks: Source | None = None,
    diagnostics: Source | None = None,
    plan: bool = True,
    trail_s: float = 2.0,
    overwrite: bool = False,
    progress: bool = False,
) -> OverlayResult:
    """Draw tracks and true boxes over the frames of a recording, as `occlog report --recording` does.

    Args:
        tracks: tracks in images or on the ground; None: only the truth is drawn.
        recording: recording with video.
        truth: true boxes.
        failures: table `failures` of `evaluate`, drawn in red.
        fundamental: epipolar geometry that the tracker used; None: that of the recording.
        scene: scene with the poses of the cameras; None: that of the recording.
        video: path of the video to write (.webm, .mp4, .avi).
        frame: number, in the first camera, of the frame to draw as a picture.
        frames: (first, stop): video of frames first <= number < stop of the first camera only.
        cameras: draw these cameras only; the first one counts the frames; empty: all.
        scale: factor by which images are enlarged, 0.05 to 16; None: to a height of about 360 px, and at most 3840 x
            2160 px in all.
        fps: frame rate of the video, 0.1 to 1000 Hz; None: that of the recording.
        ground_tracks: tracks on the ground, for the plan; None: `tracks`, if they are on the ground.
        diagnostics: table `diagnostics` of `track`, for the cameras that detect a target where its tracks do not state
            them.
        plan: draw the floor plan next to the images, for tracks on the ground.
        trail_s: length of the trail behind each target [s], 0 to 3600.
        overwrite: replace a video that exists.
        progress: show a bar on standard error, if it is a terminal.

    Returns:
        The picture of `frame`, which a notebook shows, and a summary.

    Raises:
        UsageError: there is nothing to draw, or neither `video` nor `frame` is given.
        SettingError: a number out of its range.
        InputError: an input is missing, damaged, or of another recording.
        OutputExistsError: the video exists and may not be replaced.

    Warns:
        OcclogWarning: the tracks are of another recording's video.
    """
    if isinstance(tracks, TrackResult):
        tracks = tracks.tracks
    if video is None and frame is None:
        raise UsageError("no output: give video (a file to make), frame (a number), or both", id="missing-option")
    return call(Form(OverlayRequest), dict(locals()), OverlayResult, png=_picture)
