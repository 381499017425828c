"""The tracking methods: a table of text, so that --help loads none of them.

A method is a folder with its settings (`config.py`) and one line here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from occlog.errors import UsageError, did_you_mean
from occlog.request import Form, Request, Verb, VerbKind, load
from occlog.settings import Settings

from .request import (
    ReadsRequest,
    SingleViewRequest,
    TrackInImagesRequest,
    TrackPeopleRequest,
    TrackRequest,
    TrackRequestBase,
    ViewsRequest,
)

if TYPE_CHECKING:
    from occlog.plugins.loading import Plugin

    from .interface import AnyMethod

SELECTION = ("policy", "n_cameras", "selection_interval", "model", "camera_order", "max_blind_scans")
IN_WORLD = (
    "diagnostics",
    "doa",
    "doa_labels",
    "targets",
    "labelled_only",
    "use_recovered",
    "round_robin_s",
    "residuals",
)
"""Fields of requests, and settings of their groups, that all methods take that track in the world."""
LABELLED = (*IN_WORLD, "keep_labels")
"""Options of methods with a track for each label."""
MEASURED = (
    "measurements",
    "path_loss",
    "propagation_speed",
    "tag_height",
    "sigma_range",
    "sigma_range_difference",
    "sigma_rssi",
    "rssi_power",
    "rssi_exponent",
    "measured_loss_threshold",
    "nlos_probability",
    "nlos_bias",
    "range_bias",
)
"""Options of methods that take ranges, signal strengths and time differences."""
IN_IMAGES = ("initial_ellipses", "detections", "fundamental", "ground_tracks")
"""Options of all methods that track in images."""
OF_ALL_TARGETS = ("associations", "events", "view_tracks", "doa", "gallery")
"""Options of all methods that follow all people."""
OF_TAGS = ("targets", "path_loss", "refine_bearings")
"""Options of all methods that take reads of tags."""
BEARINGS, IMAGES, BOXES, READS, VIEW = "bearings", "images", "boxes", "reads", "boxes of one camera"
UNCALIBRATED = "boxes without a calibration"
"""What a method takes in."""


@dataclass(frozen=True)
class MethodEntry:
    """One tracking method in the table of methods.

    Attributes:
        summary: one line of help.
        method: module and name (`module:name`) of the method: a value of `occlog.track.interface`, a `PeopleTracker`,
            or, of methods for images or tag reads, the function that tracks.
        settings: module and name of the class of its settings.
        takes: names of the options that it takes in addition to the shared ones and its settings.
        takes_in: kind of input: `BEARINGS`; `IMAGES`, the images of a recording; `BOXES` of all cameras; `READS` of
            tags; `UNCALIBRATED` (built-in) or `VIEW` (plug-in), the boxes of each camera separately.
        plugin: the plug-in that the method is from; None: built-in.
    """

    summary: str
    method: str
    settings: str
    takes: tuple[str, ...]
    takes_in: str = BEARINGS
    plugin: Plugin | None = None

    @property
    def images(self) -> bool:
        """Whether the method tracks in the images of a recording."""
        return self.takes_in == IMAGES


class Methods(dict[str, MethodEntry]):
    """Table of tracking methods by name: built-in ones, and installed plug-ins, which are looked up by name only.

    Iteration omits the plug-ins.
    """

    def __contains__(self, name: object) -> bool:
        """Return whether a built-in or plug-in method has that name."""
        return super().__contains__(name) or (isinstance(name, str) and _plugged(name) is not None)

    def __missing__(self, name: str) -> MethodEntry:
        """Return the plug-in method of that name; KeyError if there is none."""
        found = _plugged(name)
        if found is None:
            raise KeyError(name)
        return found


def _plugged(name: str) -> MethodEntry | None:
    """Return the plug-in method of that name; None if there is none."""
    from occlog.plugins.loading import METHOD, VIEW_TRACKER, find

    plugin = find(name, METHOD, VIEW_TRACKER)
    return None if plugin is None else entry_of(plugin)


def entry_of(plugin: Plugin) -> MethodEntry:
    """Return the table entry of a plug-in's tracking method, or of its tracker in images.

    Raises:
        PluginError: the plug-in cannot be loaded.
    """
    from occlog.plugins.loading import VIEW_TRACKER

    summary = str(plugin.load().summary)
    if plugin.kind == VIEW_TRACKER:
        return MethodEntry(summary, plugin.where, plugin.where, (), takes_in=VIEW, plugin=plugin)
    return MethodEntry(summary, plugin.where, plugin.where, LABELLED, plugin=plugin)


OURS: dict[str, MethodEntry] = {
    "apf": MethodEntry(
        "auxiliary particle filter with occlusion model and random-waypoint motion (Ercan, El Gamal, Guibas 2013)",
        "occlog.track.methods.apf.filter:METHOD",
        "occlog.track.methods.apf.config:ApfConfig",
        (*LABELLED, *MEASURED, "initial_positions", "occluders", "calibration", "particle_cloud", *SELECTION),
    ),
    "map": MethodEntry(
        "MAP trajectory from all bearings, with visibility constraints (Rahimi, Dunagan, Darrell 2004)",
        "occlog.track.methods.map.method:METHOD",
        "occlog.track.methods.map.config:MapConfig",
        (*LABELLED, *MEASURED, "initial_positions", "occluders", "motion"),
    ),
    "ekf": MethodEntry(
        "extended Kalman filter, a baseline of apf",
        "occlog.track.methods.kalman.filter:EKF",
        "occlog.track.methods.kalman.config:EkfConfig",
        (*LABELLED, *MEASURED, "initial_positions"),
    ),
    "ukf": MethodEntry(
        "unscented Kalman filter, a baseline of apf (Julier, Uhlmann 1997)",
        "occlog.track.methods.kalman.filter:UKF",
        "occlog.track.methods.kalman.config:UkfConfig",
        (*LABELLED, *MEASURED, "initial_positions"),
    ),
    "iekf": MethodEntry(
        "iterated extended Kalman filter with a MAP update per scan, a baseline of apf (Bell, Cathey 1993)",
        "occlog.track.methods.kalman.filter:IEKF",
        "occlog.track.methods.kalman.config:IekfConfig",
        (*LABELLED, "initial_positions"),
    ),
    "joint": MethodEntry(
        "joint particle filter of labelled objects that occlude one another ([Ercan] Sec. 4.4; Doucet et al. 2002)",
        "occlog.track.methods.joint.filter:METHOD",
        "occlog.track.methods.joint.config:JointConfig",
        IN_WORLD,
    ),
    "direct3d": MethodEntry(
        "particle filter in 3-D from azimuths and elevations (Lee 2009)",
        "occlog.track.methods.in_space.direct3d:METHOD",
        "occlog.track.methods.in_space.config:Direct3dConfig",
        (*LABELLED, "initial_positions", "particle_cloud", *SELECTION),
    ),
    "pps": MethodEntry(
        "projected plane selection: particle filters in the planes xy, yz and zx (Lee 2009)",
        "occlog.track.methods.in_space.projected_planes:METHOD",
        "occlog.track.methods.in_space.config:PpsConfig",
        (*LABELLED, "initial_positions", *SELECTION),
    ),
    "imm": MethodEntry(
        "multi-target IMM particle filter with JPDA for microphone arrays (Lee 2009)",
        "occlog.track.methods.imm.filter:METHOD",
        "occlog.track.methods.imm.config:ImmConfig",
        (*IN_WORLD, "initial_positions", "cooperation", "answer_delay"),
    ),
    "fix": MethodEntry(
        "position of each scan by robust triangulation, without a motion model (Lenth 1981)",
        "occlog.track.methods.fix.method:METHOD",
        "occlog.track.methods.fix.config:FixConfig",
        (*LABELLED, *MEASURED, "residuals", "reject_outliers"),
    ),
    "jipda": MethodEntry(
        "multi-camera JIPDA of people on the ground, from boxes (Musicki, Evans 2004; Williams, Lau 2014)",
        "occlog.track.people.stage:JIPDA",
        "occlog.track.methods.jipda.config:JipdaConfig",
        OF_ALL_TARGETS,
        takes_in=BOXES,
    ),
    "sort": MethodEntry(
        "in the image of each camera, from boxes, without a calibration (SORT, ByteTrack, OC-SORT; Bewley et al. 2016)",
        "occlog.track.people.image_tracks:track_in_images",
        "occlog.track.methods.sort.config:SortConfig",
        ("events",),
        takes_in=UNCALIBRATED,
    ),
    "virtual": MethodEntry(
        "tags in intersections of reader coverages, the virtual sensors (Lee 2009)",
        "occlog.track.methods.readers.stage:track_virtual",
        "occlog.track.methods.readers.config:VirtualConfig",
        (*OF_TAGS, "virtual_sensors"),
        takes_in=READS,
    ),
    "rssi": MethodEntry(
        "tags by signal strength (RSSI): particle filter with path loss and shadowing",
        "occlog.track.methods.readers.stage:track_rssi",
        "occlog.track.methods.readers.config:RssiConfig",
        OF_TAGS,
        takes_in=READS,
    ),
    "mipf": MethodEntry(
        "in images: independent particle filter per target and view (Qu, Schonfeld, Mohamed 2007)",
        "occlog.track.methods.images.run.run:run_track_views",
        "occlog.track.methods.images.methods.config:MipfConfig",
        IN_IMAGES,
        takes_in=IMAGES,
    ),
    "idmot": MethodEntry(
        "in images: interacting trackers with repulsion and inertia (Qu, Schonfeld, Mohamed 2007)",
        "occlog.track.methods.images.run.run:run_track_views",
        "occlog.track.methods.images.methods.config:IdmotConfig",
        IN_IMAGES,
        takes_in=IMAGES,
    ),
    "cmct": MethodEntry(
        "in images: particles on epipolar lines of the other views, adaptive colours; no interaction",
        "occlog.track.methods.images.run.run:run_track_views",
        "occlog.track.methods.images.methods.config:CmctConfig",
        IN_IMAGES,
        takes_in=IMAGES,
    ),
    "bmct": MethodEntry(
        "in images: idmot with collaboration of views by epipolar lines (Qu, Schonfeld, Mohamed 2007)",
        "occlog.track.methods.images.run.run:run_track_views",
        "occlog.track.methods.images.methods.config:BmctConfig",
        IN_IMAGES,
        takes_in=IMAGES,
    ),
    "mcmc": MethodEntry(
        "in images: joint particle filter of all targets of a view, by MCMC",
        "occlog.track.methods.images.run.run:run_track_views",
        "occlog.track.methods.images.methods.config:McmcConfig",
        IN_IMAGES,
        takes_in=IMAGES,
    ),
}
METHODS = Methods(OURS)
"""Every method by the name that `--method` takes."""


def entry(name: str) -> MethodEntry:
    """Return the table entry of the method `name`.

    Raises:
        UsageError: unknown name; the message suggests similar ones.
    """
    if not isinstance(name, str) or name not in METHODS:  # a text, unless Python code gives another value
        raise UsageError(f"no tracking method {name!r}; {did_you_mean(name, METHODS)}", id="unknown-name")
    return METHODS[name]


def settings_of(name: str) -> type[Settings]:
    """Return the class of settings of the method `name`; the method itself is not imported.

    Raises:
        UsageError: unknown name.
    """
    plugin = entry(name).plugin
    found: type[Settings] = load(METHODS[name].settings) if plugin is None else plugin.load().settings
    return found


def tracker(name: str) -> AnyMethod:
    """Return the method `name`, which must track by bearings.

    Raises:
        UsageError: there is no such method; the message lists all methods that track by bearings.
    """
    if name not in METHODS or METHODS[name].takes_in != BEARINGS:
        in_world = [n for n, e in METHODS.items() if e.takes_in == BEARINGS]
        raise UsageError(
            f"no tracking method {name!r} takes bearings; those that do: {', '.join(in_world)}", id="unknown-name"
        )
    plugin = METHODS[name].plugin
    if plugin is not None:
        from .plugin_filter import method_of

        return method_of(plugin)
    method: AnyMethod = load(METHODS[name].method)
    return method


def method_for(path: Path | str, scene: Path | str | None = None) -> str:
    """Return the name of the tracking method that fits the content of a file.

    It is `apf` for bearings and measurements, `virtual` for reads of tags, `jipda` for boxes or positions, and `sort`
    for boxes of cameras without a calibration. For a file that cannot be opened it is the default `apf`, which then
    reports what is wrong with the file.

    Args:
        path: the input file.
        scene: file of a scene that is given with it; None: its own.
    """
    from occlog.io.open import held
    from occlog.records.tables import Bearings, Boxes, Measurements, Positions, Reads, Views

    tables = held(Path(path), Bearings, Measurements, Boxes, Views, Positions, Reads)
    if not tables or Bearings in tables or Measurements in tables:
        return VERB.default
    if tables == (Reads,):
        return "virtual"
    calibrated = Positions in tables or _calibrated(Path(path), None if scene is None else Path(scene))
    return "jipda" if calibrated else "sort"


def _calibrated(path: Path, scene: Path | None) -> bool:
    """Return whether the cameras of the boxes in `path` have poses: in the file `scene`, or else in `path` itself.

    True if a file cannot be opened.
    """
    from occlog.errors import OcclogError
    from occlog.io.open import open_input, scene_in
    from occlog.records.tables import Boxes, Views

    try:
        opened = open_input(path)
        found = opened.scene if scene is None else scene_in(scene)
        if found is not None and found.cameras:
            return any(camera.has_height or camera.placed for camera in found.cameras)
        if scene is not None or opened.recording is not None or opened.has(Boxes):
            return False
        first = next(iter(opened.rows(Views)), None)
        return first is not None and bool((first.bearing == first.bearing).any())
    except (OcclogError, OSError):
        return True


def smooths(command: str, parameters: Mapping[str, object]) -> bool:
    """Return whether a command with these parameters makes smoothed tracks (estimates that use later measurements).

    Args:
        command: name of the command in the provenance of the tracks.
        parameters: its parameters there, by name.
    """
    if command != "track":
        return False
    return parameters.get("method") == "map" or bool(parameters.get("smooth")) or parameters.get("lag_s") is not None


REQUESTS: Mapping[str, type[Request]] = {
    BEARINGS: TrackRequest,
    BOXES: TrackPeopleRequest,
    READS: ReadsRequest,
    UNCALIBRATED: TrackInImagesRequest,
    VIEW: SingleViewRequest,
    IMAGES: ViewsRequest,
}
"""The request of a method by what it takes in."""


def form_of(method: str) -> Form:
    """Return the form of a method's request: its inputs, options and settings.

    Raises:
        UsageError: unknown method.
    """
    found = entry(method)
    around = (load("occlog.track.methods.images.initiation.config:ViewsConfig"),) if found.images else ()
    shared = (each.name for each in Form(TrackRequestBase).entries())
    settings = {"settings": settings_of(method)}
    return Form(REQUESTS[found.takes_in], {*shared, *found.takes, "settings"}, settings, around)


def _plugged_kinds() -> dict[str, VerbKind]:
    """Return the methods of installed plug-ins by name, as kinds of the verb.

    Plug-ins with the name of a built-in method are omitted.
    """
    from occlog.plugins.loading import METHOD, VIEW_TRACKER, installed

    plugins = (*installed(METHOD), *installed(VIEW_TRACKER))
    return {each.name: VerbKind(each.summary, partial(form_of, each.name)) for each in plugins if each.name not in OURS}


_FILTERS = """
    Each labelled target is tracked separately. Unlabelled candidates (target_id -1) are offered to every track; without
    any labels they make one track, of the target at --start if that is given. The directions of arrival in a recording
    are used along with its bearings.
"""
_DISTANCES = """
    Ranges, signal strengths and time differences are used too, from --measurements or instead of BEARINGS.
"""
_VIEWS = """
    BEARINGS is a recording with images; the targets are ellipses, and tracks are `view_tracks`. `occlog ground`
    triangulates them.
"""
_TAGS = """
    BEARINGS is a recording, or a table, with reads of tags by fixed readers. A track has the identity of its tag, which
    `occlog label` gives to bearings.
"""
_ABOUT = {
    "jipda": """
    BEARINGS is a recording with boxes of calibrated cameras or positions on the ground, or a table of boxes or views.
    No labels, initial positions or target count are needed: tracks are initiated, confirmed and terminated by their
    existence probability.
    --smooth and --lag use later measurements.

    \b
      occlog track views.parquet --scene hall.mcap --method jipda -o tracks.parquet --view-tracks in_images.parquet
    """,
    "sort": """
    BEARINGS is a recording with boxes, or a table of boxes or views: of `occlog detect`, MOTChallenge text, YOLO, COCO.
    Each camera is tracked in its own image; nothing is known of its pose, and an identity is of one camera alone.
    Tracks are `view_tracks`, which `occlog export --to mot`, `occlog evaluate` and `occlog report --recording` take.

    \b
      occlog track views.parquet --method sort -o view_tracks.parquet --events events.parquet
    """,
    "imm": """
    Targets are tracked from the bearings of microphone arrays, labelled or not; their number is estimated. With
    --cooperate camera frames are requested.

    \b
      occlog track directions.mcap --method imm --cooperate spread --set request_sigma=0.5 -o tracks.parquet
    """,
    "map": f"""
    The most probable trajectory of each labelled target (`occlog label`) from all measurements, past and future;
    cameras need not overlap.
    {_DISTANCES}
    \b
      occlog track labelled.parquet --scene scene.yaml --method map --set loss=huber -o map.parquet
    """,
    "joint": """
    One filter for all labelled objects of a recording, in which they occlude one another.

    \b
      occlog track labelled.parquet --scene scene.yaml --method joint -o tracks.parquet
    """,
}
"""Paragraphs of the help of a method, with an example."""


def about(name: str) -> str:
    """Return the paragraphs of the help of the built-in method `name`, with an example command."""
    if name in _ABOUT:
        return _ABOUT[name]
    each = OURS[name]
    file = {IMAGES: "video.mcap", READS: "tags.mcap"}.get(each.takes_in, "bearings.parquet --scene scene.yaml")
    out = "view_tracks" if each.images else "tracks"
    text = {IMAGES: _VIEWS, READS: _TAGS}.get(each.takes_in, _FILTERS)
    more = _DISTANCES if "measurements" in each.takes else ""
    return f"{text}{more}\n    \b\n      occlog track {file} --method {name} -o {out}.parquet\n"


VERB = Verb(
    TrackRequestBase,
    {name: VerbKind(each.summary, partial(form_of, name), about=about(name)) for name, each in OURS.items()},
    default="apf",
    fits="occlog.track.catalogue:method_for",
    by={"method": str},
    what="method",
    chosen_by="--method {}",
    more=_plugged_kinds,
    shows_default=False,
    example="process_noise_position=0.3",
)
