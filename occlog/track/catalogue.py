"""The tracking methods: a table of text, so that --help loads none of them.

A method is a folder with its settings (`config.py`) and one line here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from occlog.errors import UsageError, did_you_mean
from occlog.request import Form, Request, Verb, VerbKind, load
from occlog.settings import Settings

from .request import ReadsRequest, SingleViewRequest, TrackPeopleRequest, TrackRequest, TrackRequestBase, ViewsRequest

if TYPE_CHECKING:
    from occlog.plugins.loading import Plugin

    from .interface import AnyMethod

SELECTION = ("policy", "count", "every", "model", "order", "patience")
IN_WORLD = (
    "diagnostics",
    "doa",
    "doa_labels",
    "targets",
    "labelled_only",
    "use_recovered",
    "in_turn",
    "residuals",
)
"""Fields of requests, and settings of their groups, that all methods take that track in the world."""
MEASURED = (
    "measurements",
    "path_loss",
    "propagation",
    "tag_height",
    "sigma_range",
    "sigma_difference",
    "sigma_rssi",
    "rssi_power",
    "rssi_exponent",
    "measured_bend",
    "measured_late",
    "detour",
)
"""Options of methods that take ranges, signal strengths and time differences."""
IN_IMAGES = ("initial", "detections", "fundamental", "world")
"""Options of all methods that track in images."""
OF_EVERYBODY = ("support", "events", "view_tracks", "doa", "gallery")
"""Options of all methods that follow all people."""
OF_TAGS = ("targets", "path_loss", "sights")
"""Options of all methods that take reads of tags."""
BEARINGS, IMAGES, BOXES, READS, VIEW = "bearings", "images", "boxes", "reads", "boxes of one camera"
"""What a method takes in."""


@dataclass(frozen=True)
class MethodEntry:
    """A method.

    Attributes:
        summary: one line.
        method: module and name of the method, a value of `occlog.track.interface`, or of `Follower` for one that
            follows all people; of one that takes images or reads the function that tracks.
        settings: module and name of the class of its settings.
        takes: names of the options that it takes in addition to the shared ones and its settings.
        takes_in: `BEARINGS`; `IMAGES`: it tracks in the images of a recording; `BOXES`: it follows all people by them;
            `READS`: reads of tags; `VIEW`: it follows each camera's boxes on their own.
        plugin: that the method is from; None: it is one of ours.
    """

    summary: str
    method: str
    settings: str
    takes: tuple[str, ...]
    takes_in: str = BEARINGS
    plugin: Plugin | None = None

    @property
    def images(self) -> bool:
        """Whether it tracks in the images of a recording."""
        return self.takes_in == IMAGES


class Methods(dict[str, MethodEntry]):
    """Our methods; a name that is none of them is looked for among the plug-ins, which are not iterated over."""

    def __contains__(self, name: object) -> bool:
        """Whether there is a method of that name, ours or a plug-in's."""
        return super().__contains__(name) or (isinstance(name, str) and _plugged(name) is not None)

    def __missing__(self, name: str) -> MethodEntry:
        """The method of a plug-in; KeyError where missing of that name."""
        found = _plugged(name)
        if found is None:
            raise KeyError(name)
        return found


def _plugged(name: str) -> MethodEntry | None:
    """The method of a plug-in; None where missing of that name."""
    from occlog.plugins.loading import METHOD, VIEW_TRACKER, find

    plugin = find(name, METHOD, VIEW_TRACKER)
    return None if plugin is None else entry_of(plugin)


def entry_of(plugin: Plugin) -> MethodEntry:
    """The line of a plug-in's method; PluginError where it cannot be loaded."""
    from occlog.plugins.loading import VIEW_TRACKER

    summary = str(plugin.load().summary)
    if plugin.kind == VIEW_TRACKER:
        return MethodEntry(summary, plugin.where, plugin.where, (), takes_in=VIEW, plugin=plugin)
    return MethodEntry(summary, plugin.where, plugin.where, IN_WORLD, plugin=plugin)


OURS: dict[str, MethodEntry] = {
    "apf": MethodEntry(
        "auxiliary particle filter with random waypoints (Ercan, El Gamal, Guibas 2013)",
        "occlog.track.methods.apf.filter:METHOD",
        "occlog.track.methods.apf.config:ApfConfig",
        (*IN_WORLD, *MEASURED, "starts", "occluders", "calibration", "cloud", *SELECTION),
    ),
    "map": MethodEntry(
        "most probable trajectory from all bearings at once (Rahimi, Dunagan, Darrell 2004)",
        "occlog.track.methods.map.method:METHOD",
        "occlog.track.methods.map.config:MapConfig",
        (*IN_WORLD, *MEASURED, "starts", "occluders", "motion"),
    ),
    "ekf": MethodEntry(
        "baseline of apf: extended Kalman filter of readings and bearings",
        "occlog.track.methods.kalman.filter:EKF",
        "occlog.track.methods.kalman.config:EkfConfig",
        (*IN_WORLD, *MEASURED, "starts"),
    ),
    "ukf": MethodEntry(
        "baseline of apf: unscented Kalman filter (Julier, Uhlmann 1997)",
        "occlog.track.methods.kalman.filter:UKF",
        "occlog.track.methods.kalman.config:UkfConfig",
        (*IN_WORLD, *MEASURED, "starts"),
    ),
    "iekf": MethodEntry(
        "baseline of apf: MAP estimate of each scan in a Kalman filter, the iterated EKF (Bell, Cathey 1993)",
        "occlog.track.methods.kalman.filter:IEKF",
        "occlog.track.methods.kalman.config:IekfConfig",
        (*IN_WORLD, "starts"),
    ),
    "joint": MethodEntry(
        "one particle filter for all labelled objects, which hide one another ([Ercan] Sec. 4.4; Doucet et al. 2002)",
        "occlog.track.methods.joint.filter:METHOD",
        "occlog.track.methods.joint.config:JointConfig",
        IN_WORLD,
    ),
    "direct3d": MethodEntry(
        "particle filter in space from azimuths and elevations (Lee 2009)",
        "occlog.track.methods.in_space.direct3d:METHOD",
        "occlog.track.methods.in_space.config:Direct3dConfig",
        (*IN_WORLD, "starts", "cloud", *SELECTION),
    ),
    "pps": MethodEntry(
        "projected planes selection: particle filters in the planes xy, yz and zx (Lee 2009)",
        "occlog.track.methods.in_space.projected_planes:METHOD",
        "occlog.track.methods.in_space.config:PpsConfig",
        (*IN_WORLD, "starts", *SELECTION),
    ),
    "imm": MethodEntry(
        "several motion models for several targets that microphone arrays hear, unlabelled (Lee 2009)",
        "occlog.track.methods.imm.filter:METHOD",
        "occlog.track.methods.imm.config:ImmConfig",
        (*IN_WORLD, "starts", "cooperation", "answer_delay"),
    ),
    "fix": MethodEntry(
        "each time step's position from its bearings alone (Lenth 1981)",
        "occlog.track.methods.fix.method:METHOD",
        "occlog.track.methods.fix.config:FixConfig",
        (*IN_WORLD, *MEASURED, "residuals"),
    ),
    "jipda": MethodEntry(
        "all people on the ground plane, from boxes of all cameras jointly (Musicki, Evans 2004; Williams, Lau 2014)",
        "occlog.track.people.stage:JIPDA",
        "occlog.track.methods.jipda.config:JipdaConfig",
        OF_EVERYBODY,
        takes_in=BOXES,
    ),
    "virtual": MethodEntry(
        "tags in the regions that sets of readers cover, the virtual sensors (Lee 2009)",
        "occlog.track.methods.readers.stage:track_virtual",
        "occlog.track.methods.readers.config:VirtualConfig",
        (*OF_TAGS, "virtual_sensors"),
        takes_in=READS,
    ),
    "rssi": MethodEntry(
        "tags by the strength of their signals: particles with path loss and shadowing",
        "occlog.track.methods.readers.stage:track_rssi",
        "occlog.track.methods.readers.config:RssiConfig",
        OF_TAGS,
        takes_in=READS,
    ),
    "mipf": MethodEntry(
        "in images: a particle filter for each target and view, on its own (Qu, Schonfeld, Mohamed 2007)",
        "occlog.track.methods.images.run.run:run_track_views",
        "occlog.track.methods.images.methods.config:MipfConfig",
        IN_IMAGES,
        takes_in=IMAGES,
    ),
    "idmot": MethodEntry(
        "in images: trackers that touch repel each other and keep their ways (Qu, Schonfeld, Mohamed 2007)",
        "occlog.track.methods.images.run.run:run_track_views",
        "occlog.track.methods.images.methods.config:IdmotConfig",
        IN_IMAGES,
        takes_in=IMAGES,
    ),
    "cmct": MethodEntry(
        "in images: particles on the epipolar lines of the other views, colours that adapt; no interaction",
        "occlog.track.methods.images.run.run:run_track_views",
        "occlog.track.methods.images.methods.config:CmctConfig",
        IN_IMAGES,
        takes_in=IMAGES,
    ),
    "bmct": MethodEntry(
        "in images: as idmot, helped by the other views through epipolar lines (Qu, Schonfeld, Mohamed 2007)",
        "occlog.track.methods.images.run.run:run_track_views",
        "occlog.track.methods.images.methods.config:BmctConfig",
        IN_IMAGES,
        takes_in=IMAGES,
    ),
    "mcmc": MethodEntry(
        "in images: a filter for each view, whose samples hold all of its targets",
        "occlog.track.methods.images.run.run:run_track_views",
        "occlog.track.methods.images.methods.config:McmcConfig",
        IN_IMAGES,
        takes_in=IMAGES,
    ),
}
METHODS = Methods(OURS)
"""Every method by the name that `--method` takes."""


def entry(name: str) -> MethodEntry:
    """The method's line in the table; UsageError names the nearest method, or all."""
    if name not in METHODS:
        raise UsageError(f"no tracking method {name!r}; {did_you_mean(name, METHODS)}")
    return METHODS[name]


def settings_of(name: str) -> type[Settings]:
    """The class of a method's settings; loads the method's `config.py`, which loads nothing heavy."""
    plugin = entry(name).plugin
    found: type[Settings] = load(METHODS[name].settings) if plugin is None else plugin.load().settings
    return found


def tracker(name: str) -> AnyMethod:
    """The method of that name, which takes bearings; UsageError names the ones there are."""
    if name not in METHODS or METHODS[name].takes_in != BEARINGS:
        in_world = [n for n, e in METHODS.items() if e.takes_in == BEARINGS]
        raise UsageError(f"no tracking method {name!r}; there are: {', '.join(in_world)}")
    plugin = METHODS[name].plugin
    if plugin is not None:
        from .plugged import method_of

        return method_of(plugin)
    method: AnyMethod = load(METHODS[name].method)
    return method


def smooths(command: str, parameters: Mapping[str, object]) -> bool:
    """Whether tracks that a command made with these parameters know what came after them.

    Args:
        command: as the tracks' provenance names it.
        parameters: likewise.
    """
    if command != "track":
        return False
    return parameters.get("method") == "map" or bool(parameters.get("smooth")) or parameters.get("lag_s") is not None


REQUESTS: Mapping[str, type[Request]] = {
    BEARINGS: TrackRequest,
    BOXES: TrackPeopleRequest,
    READS: ReadsRequest,
    VIEW: SingleViewRequest,
    IMAGES: ViewsRequest,
}
"""The request of a method by what it takes in."""


def form_of(method: str) -> Form:
    """The form of a request for a method; UsageError where there is no such method."""
    found = entry(method)
    around = (load("occlog.track.methods.images.births.config:ViewsConfig"),) if found.images else ()
    shared = (each.name for each in Form(TrackRequestBase).entries())
    settings = {"settings": settings_of(method)}
    return Form(REQUESTS[found.takes_in], {*shared, *found.takes, "settings"}, settings, around)


def _plugged_kinds() -> dict[str, VerbKind]:
    """The methods of installed plug-ins."""
    from occlog.plugins.loading import METHOD, VIEW_TRACKER, installed

    plugins = (*installed(METHOD), *installed(VIEW_TRACKER))
    return {each.name: VerbKind(each.summary, partial(form_of, each.name)) for each in plugins if each.name not in OURS}


VERB = Verb(
    TrackRequestBase,
    {name: VerbKind(each.summary, partial(form_of, name)) for name, each in OURS.items()},
    default="apf",
    by={"method": str},
    what="method",
    chosen_by="--method {}",
    more=_plugged_kinds,
    shows_default=False,
    example="sigma_v=0.3",
)
