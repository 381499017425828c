"""Requests (inputs, outputs and options) of `occlog track`, one class for each kind of measurement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from occlog.request import Request, group, load, output_file, scene_file, seed_of_all, sink, source
from occlog.scans.config import DistanceMeasurementConfig
from occlog.settings import option_setting, setting

LONGEST_S = 1e9
"""Longest time that times can be apart [s]."""
NS_PER_S = 1e9


@dataclass(frozen=True, kw_only=True)
class TrackRequestBase(Request):
    """Track targets from BEARINGS: a recording, or a table of bearings, boxes or tag reads.

    Without --method it follows from the input: boxes of calibrated cameras jipda, other boxes sort, tag reads virtual,
    else apf. `occlog track --method NAME --help` describes one method. The same inputs, options and seed give the same
    output.

    --method jipda tracks all people on the ground plane from the boxes of all calibrated cameras and from positions on
    the ground; BEARINGS is a recording with boxes or positions, or a table of boxes or views. No labels, initial
    positions or target count are needed.

    --method sort tracks people in the image of each camera, which needs no calibration: MOTChallenge text, YOLO, COCO,
    or what `occlog detect` finds in a video. It writes `view_tracks`; an identity is of one camera alone.

    --method apf, ekf, ukf, iekf, map, fix, direct3d, pps and joint track targets from bearings and directions of
    arrival. Each labelled target has its own filter (joint: one for all). Unlabelled candidates (target_id -1) are
    offered to every filter; without any labels they make one track, of the target at --start if that is given. The
    directions of arrival in a recording are used along with its bearings. apf, ekf, ukf, map and fix also take
    ranges, signal strengths and time differences, in --measurements or instead of BEARINGS.

    --method imm tracks an unknown number of targets from microphone arrays, labelled or not; with --cooperate it
    requests camera frames. --method map estimates the most probable trajectory of each labelled target from all
    measurements, past and future; cameras need not overlap.

    --method mipf, idmot, cmct, bmct and mcmc track targets as ellipses in the images of a recording; they write
    `view_tracks`. --method virtual and rssi locate radio tags from the reads of fixed readers; a track has the
    identity of its tag, which `occlog label` gives to bearings.

    \b
      occlog track views.parquet --scene hall.mcap --method jipda -o tracks.parquet
      occlog track views.parquet --method sort -o view_tracks.parquet
      occlog track bearings.parquet --scene scene.yaml -o tracks.parquet --diagnostics diagnostics.parquet
      occlog track bearings.parquet --scene hall.mcap --without cam4 --start 4,1.5,0.5 -o without4.parquet
      occlog track bearings.parquet --scene scene.yaml --select greedy --n-cameras 3 -o selected.parquet
      occlog track directions.mcap --method imm --cooperate spread -o tracks.parquet
      occlog track labelled.parquet --scene scene.yaml --method map --set loss=huber -o map.parquet
      occlog track ranges.csv --scene stations.csv --method fix -o tracks.parquet
      occlog track balls.mcap --method bmct --initial-ellipses balls.mcap -o view_tracks.parquet
      occlog track tags.mcap --method rssi --path-loss readers.json -o tags.parquet
    """

    OWNER: ClassVar[str] = "track"

    bearings: Path = source(
        "Bearings, boxes, tag reads (tables), or a recording that holds them or video.", argument=True
    )
    output: Path = output_file("Tracks (Parquet).", "tracks")
    scene: Path | None = scene_file()
    method: str = option_setting(
        "apf",
        "Tracking method. [default: by the input: boxes jipda, without a calibration sort, tag reads virtual, else "
        "apf; in a configuration apf]",
        metavar="NAME",
        shown="",
    )
    cameras: tuple[str, ...] = option_setting((), "Use only the sensors of these names.", metavar="A,B,...", shown="")
    without: tuple[str, ...] = option_setting(
        (),
        "Exclude the sensors of these names, for example to predict them with `evaluate --held-out`.",
        metavar="A,B,...",
        shown="",
    )
    window: float | None = option_setting(
        None,
        "Measurements closer together in time make one scan (time step). Too wide merges frames of one camera; too "
        "narrow splits synchronised frames. [default: equal times; frames: below half the shortest frame period; "
        "reads: 1 s]",
        unit="s",
        at_least=0,
        at_most=LONGEST_S,
        shown="",
    )
    seed: int = seed_of_all()
    settings: Mapping[str, object] = group(None, example="process_noise_position=0.3")

    @property
    def window_ns(self) -> int | None:
        """Window within which measurements form one scan [ns]; None if not given."""
        return None if self.window is None else round(self.window * NS_PER_S)


@dataclass(frozen=True, kw_only=True)
class _InWorld(TrackRequestBase):
    """Request of a method that tracks on the ground plane, from bearings or tag reads: fields that these share."""

    JUDGED: ClassVar[bool] = True

    path_loss: Path | None = source(
        "Path loss model of the tag readers (JSON, from `occlog fit-readers`). [default: settings]"
    )
    targets: tuple[int, ...] = setting(
        (),
        "Track this target ID only; may be repeated. With unlabelled input the first ID names the track.",
        at_least=0,
        option="--target",
        metavar="ID",
        repeat=True,
        shown="",
    )


@dataclass(frozen=True, kw_only=True)
class TrackRequest(_InWorld):
    """Request of a method that tracks targets from bearings and directions of arrival.

    Fields are the inputs of such a method (directions, distances, occluders, motion model), its output tables, and
    options.
    """

    RUN: ClassVar[str] = "occlog.track.run:run_track"

    diagnostics: Path | None = sink(
        "Write filter diagnostics per time step: effective sample size, likelihood, restarts (Parquet). Check them "
        "first when a track is lost.",
        "diagnostics",
    )
    residuals: Path | None = sink(
        "Write the normalised residual and inlier probability of each bearing (Parquet).", "residuals"
    )
    particle_cloud: Path | None = sink(
        "Write up to 200 weighted particles per time step, before smoothing (Parquet).",
        "particles",
        asked="also",
    )
    calibration: Path | None = sink(
        "Write the estimated pose errors of the cameras (extrinsics, Parquet); needs --set calibrate=joint or initial.",
        "calibration",
        asked="also",
    )
    doa: Path | None = source("Additional directions of arrival: a table, or a recording that holds them.")
    doa_labels: bool = option_setting(
        False,
        "Source IDs in the log of directions are target IDs. [default: directions are unlabelled candidates]",
        shown="",
    )
    measurements: Path | None = source(
        "Additional ranges, signal strengths and time differences: a table, or a recording with tag reads.",
        there=False,
    )
    measured: Mapping[str, object] = group(lambda: DistanceMeasurementConfig)
    occluders: Path | None = source(
        "Moving occluders: priors from `occlog priors` (`occluders` or `hulls`, Parquet), or truth (known "
        "exactly). Without them a missed detection may mean an occlusion that the filter cannot predict."
    )
    select: Mapping[str, object] = group(lambda: load("occlog.track.methods.apf.config:SelectConfig"))
    initial_positions: tuple[str, ...] = setting(
        (),
        "Initial position with standard deviation SIGMA (0.5 m if omitted, 1 in a scene-specific unit); for "
        "--method imm also X,Y,SIGMA,VX,VY,SIGMA_V. May be repeated, once per target. [default: uniform over the "
        "room, or over the visible region]",
        option="--start",
        metavar="X,Y[,SIGMA]",
        repeat=True,
        whole=True,
        shown="",
    )
    cooperation: Path | None = sink(
        "Write the requests to cameras and their answers (Parquet).", "cooperation", asked="also"
    )
    answer_delay: float | Path | None = source(
        "Latency of the cameras' answers in seconds, or that of the slowest router in a table of delays from "
        "`occlog traffic` (one case, Parquet). [default: 0]",
        number=0.0,
        metavar="SECONDS|FILE",
    )
    labelled_only: bool = option_setting(False, "Ignore unlabelled candidates.", shown="")
    keep_labels: bool = option_setting(
        False,
        "Keep labels as given where two targets exchange theirs. [default: a target keeps the identity of its first "
        "label, and exchanged labels are exchanged back; both are reported]",
        shown="",
    )
    reject_outliers: bool = option_setting(
        False,
        "Give method fix no labelled bearings that contradict the motion of their target while "
        "others of the same time agree with it. Rows with such bearings are then not flagged. [default: they are used, "
        "and reported where they are many]",
        shown="",
    )
    use_recovered: bool = option_setting(
        False,
        "Treat detections recovered by `occlog fuse` as measurements. [default: as missed]",
        shown="",
    )
    round_robin_s: float | None = setting(
        None,
        "Round robin: use one sensor at a time for this long each, in the order of the scene. [default: all sensors]",
        unit="s",
        above=0,
        at_most=LONGEST_S,
        option="--round-robin",
        shown="",
    )
    motion: Path | None = source("Motion model from `occlog fit-motion` (JSON).")

    @property
    def inputs(self) -> list[Path]:
        """All files that the request reads, without those that are not given."""
        delays = self.answer_delay if isinstance(self.answer_delay, Path) else None
        own = (self.bearings, self.scene, self.doa, self.occluders, self.motion, delays)
        return [path for path in (*own, self.measurements, self.path_loss) if path is not None]


@dataclass(frozen=True, kw_only=True)
class TrackPeopleRequest(TrackRequestBase):
    """Request of a method that tracks people on the ground plane from the boxes of all cameras.

    Fields are further inputs (directions of arrival, appearance gallery) and output tables (associations, events,
    tracks in the images).
    """

    RUN: ClassVar[str] = "occlog.track.people.run:run_track_people"
    JUDGED: ClassVar[bool] = True

    doa: Path | None = source("Directions of arrival to use too: a table, or a recording that holds them.")
    associations: Path | None = sink(
        "Write the association probabilities of detections and tracks (Parquet).", "associations"
    )
    events: Path | None = sink(
        "Write track initiations and terminations, re-identifications and possible identity switches (Parquet).",
        "events",
    )
    gallery: Path | None = source(
        "Appearance gallery (Parquet, from `occlog appearance learn`): re-identifies tracks and joins the "
        "fragments of a track that was lost."
    )
    view_tracks: Path | None = sink(
        "Write all tracks projected into every image, occluded ones too (Parquet).", "view_tracks", asked="also"
    )


@dataclass(frozen=True, kw_only=True)
class TrackInImagesRequest(TrackRequestBase):
    """Request of a method that tracks people in the image of each camera, without calibration.

    Fields are its output tables: tracks in the images, and events.
    """

    RUN: ClassVar[str] = "occlog.track.people.run:run_track_in_images"
    JUDGED: ClassVar[bool] = True

    output: Path = output_file("Tracks in the images (Parquet).", "view_tracks", result="tracks")
    events: Path | None = sink(
        "Write track initiations and terminations and possible identity switches (Parquet).", "events"
    )


@dataclass(frozen=True, kw_only=True)
class SingleViewRequest(TrackRequestBase):
    """Request of a plug-in method that tracks boxes in each camera separately.

    It has the shared fields, and an output table of boxes with identities.
    """

    RUN: ClassVar[str] = "occlog.track.single_view.run:run_track_single_view"

    output: Path = output_file(
        "Tracks in the images of each camera (boxes with identities, Parquet).", "boxes", result="tracks"
    )


@dataclass(frozen=True, kw_only=True)
class ReadsRequest(_InWorld):
    """Request of a method that locates radio tags from reads of fixed readers.

    Fields are bearings that refine the positions, and an output table of the regions that sets of readers cover.
    """

    RUN: ClassVar[str] = "occlog.track.methods.readers.run:run_track_reads"

    refine_bearings: Path | None = source(
        "Bearings of the cameras of --refine: a table, or a recording. [default: those of the recording]"
    )
    virtual_sensors: Path | None = sink(
        "Write the regions covered by sets of readers, with area, centroid and covariance (Parquet).",
        "virtual_sensors",
        asked="also",
    )


@dataclass(frozen=True, kw_only=True)
class ViewsRequest(TrackRequestBase):
    """Request of a method that tracks targets in the images of a recording.

    Fields are what initiates trackers (ellipses or detections), fundamental matrices, and output tables.
    """

    RUN: ClassVar[str] = "occlog.track.methods.images.run.run:run_track_views"

    output: Path = output_file("Tracks (Parquet).", "view_tracks")
    initial_ellipses: Path | None = source(
        "Initial ellipses in each view: CSV, or boxes with identities (Parquet, or a recording that holds true "
        "boxes). [default: initiate from detections]"
    )
    detections: Path | None = source(
        "Detections that initiate trackers: boxes of a detector, or views of `occlog detect`. [default without "
        "--initial-ellipses: boxes in the recording, else its moving regions]"
    )
    fundamental: Path | None = source(
        "Fundamental matrices (JSON, from `occlog epipolar`). [default: camera poses of --scene, matrices in the "
        "recording, poses of its scene]"
    )
    ground_tracks: Path | None = sink(
        "Write ground tracks, triangulated from all views that track a target (Parquet).", "tracks", asked="also"
    )

    @property
    def births(self) -> str:
        """How trackers begin, by the given files: from `initial` ellipses, from `detections`, or `both`."""
        if self.initial_ellipses is None:
            return "detections"
        return "initial" if self.detections is None else "both"
