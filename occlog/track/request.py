"""What `occlog track` takes, for each kind of measurements that methods take."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from occlog.request import Request, group, load, output_file, scene_file, seed_of_all, sink, source
from occlog.scans.config import DistanceMeasurementConfig
from occlog.settings import setting

LONGEST_S = 1e9
"""Longest time that times can be apart [s]."""
NS_PER_S = 1e9


@dataclass(frozen=True, kw_only=True)
class TrackRequestBase(Request):
    """Estimate target tracks from BEARINGS (Parquet, or a recording that holds bearings).

    Each labelled target has its own filter. Candidates without a label (target_id -1, for example
    a detector's boxes or directions of arrival) are offered to every filter; where nothing is
    labelled they make one track, of the target at --start if that is given. A recording's
    directions of arrival are used along with its bearings.
    The same inputs, options and seed give the same output.

    --method imm has one state for all targets that microphone arrays hear, labelled or not: it says
    how many there are, and asks cameras where they are when --cooperate says so.

    --method map finds the most probable trajectory of each labelled target from everything that was
    recorded, before and after; it needs no cameras that overlap, but labels (`occlog label`).

    --method mipf, idmot, cmct, bmct and mcmc follow many targets as ellipses in the images of a recording
    instead, which then stands in the place of BEARINGS; they write `view_tracks`.

    --method jipda follows all people on the floor by the boxes of all calibrated cameras: BEARINGS is then a
    recording with boxes, or a table of views or boxes. Nobody need be labelled, and nothing be known of the start.

    --method virtual and rssi locate radio tags: BEARINGS is then a recording (or a table) with the reads of fixed
    readers. A tag's track has the tag's identity, which `occlog label` gives to bearings.

    --method apf, ekf, fix, map and ukf also take ranges, signal strengths and time differences of stations: in
    --measurements beside bearings, or in the place of BEARINGS.

    \b
      occlog track bearings.parquet --scene scene.yaml -o tracks.parquet --diagnostics diagnostics.parquet
      occlog track bearings.parquet --scene hall.mcap --without cam4 --start 4,1.5,0.5 -o without4.parquet
      occlog track bearings.parquet --scene scene.yaml --occluders occluders.parquet --select greedy --count 3 \
        -o selected.parquet --diagnostics selected_diagnostics.parquet
      occlog track directions.mcap --method imm --cooperate spread --set spread=0.5 -o heard.parquet \
        --cooperation asked.parquet
      occlog track balls.mcap --method bmct --initial balls.mcap -o view_tracks.parquet
      occlog track views.parquet --scene hall.mcap --method jipda -o tracks.parquet --view-tracks in_images.parquet
      occlog track labelled.parquet --scene scene.yaml --method map --set loss=huber -o map.parquet
      occlog track tags.mcap --method rssi --path-loss readers.json -o tags.parquet
      occlog track ranges.csv --scene stations.csv --method fix -o tracks.parquet
    """

    OWNER: ClassVar[str] = "track"

    bearings: Path = source("Bearings, boxes, reads of tags, or a recording with video.", argument=True)
    output: Path = output_file("Tracks (Parquet).", "tracks")
    scene: Path | None = scene_file()
    method: str = setting("apf", "Tracking method.", option="--method", metavar="NAME")
    cameras: tuple[str, ...] = setting((), "Use only these sensors.", option="--cameras", metavar="A,B,...", shown="")
    without: tuple[str, ...] = setting((), "Leave these sensors out.", option="--without", metavar="A,B,...", shown="")
    window: float | None = setting(
        None,
        "Measurements this close together in time make one scan. [default: equal times; frames: below half the "
        "shortest frame period; reads: 1]",
        unit="s",
        at_least=0,
        at_most=LONGEST_S,
        option="--window",
        metavar="SECONDS",
        shown="",
    )
    seed: int = seed_of_all()
    settings: Mapping[str, object] = group(None, example="sigma_v=0.3")

    @property
    def window_ns(self) -> int | None:
        """The window [ns]; None: it was not given."""
        return None if self.window is None else round(self.window * NS_PER_S)


@dataclass(frozen=True, kw_only=True)
class _InWorld(TrackRequestBase):
    """What methods take that track in the world by bearings, or by reads of tags."""

    JUDGED: ClassVar[bool] = True

    path_loss: Path | None = source(
        "How strongly readers read tags (JSON, see `occlog fit-readers`). [default: settings]"
    )
    targets: tuple[int, ...] = setting(
        (),
        "Track only this target; may be repeated. The first also numbers a track without labels.",
        at_least=0,
        option="--target",
        metavar="ID",
        repeat=True,
        shown="",
    )


@dataclass(frozen=True, kw_only=True)
class TrackRequest(_InWorld):
    """Bearings to track targets by."""

    RUN: ClassVar[str] = "occlog.track.run:run_track"

    diagnostics: Path | None = sink("How the filter fared at each time (Parquet).", "diagnostics")
    residuals: Path | None = sink(
        "How each bearing agrees with the estimate, and whether it is believed (Parquet).", "residuals"
    )
    cloud: Path | None = sink(
        "Where the particles of the filter are at each time, 200 at most, as before any smoothing (Parquet).",
        "particles",
        asked="also",
    )
    calibration: Path | None = sink(
        "Errors of the cameras' poses as estimated, with --set calibrate=joint or initial (Parquet).",
        "calibration",
        asked="also",
    )
    doa: Path | None = source("Directions of arrival to use too: a table, or a recording that holds them.")
    doa_labels: bool = setting(
        False,
        "Identities in the log of directions are those of targets. [default: directions may be of anything]",
        option="--doa-labels",
        shown="",
    )
    measurements: Path | None = source(
        "Ranges, signal strengths and time differences to use too: a table, or a recording with reads of tags.",
        there=False,
    )
    measured: Mapping[str, object] = group(lambda: DistanceMeasurementConfig)
    occluders: Path | None = source(
        "Where moving occluders may be: `occluders` or `hulls` (Parquet, see `occlog priors`), or truth (known "
        "exactly)."
    )
    select: Mapping[str, object] = group(lambda: load("occlog.track.methods.apf.config:SelectConfig"))
    starts: tuple[str, ...] = setting(
        (),
        "Where the target is at first; SIGMA is 0.5 m, or 1 in units of its own, if left out. For --method imm "
        "also X,Y,SIGMA,VX,VY,SIGMA_V; may be repeated, once a target. [default: anywhere in the room, or where "
        "sensors see]",
        option="--start",
        metavar="X,Y[,SIGMA]",
        repeat=True,
        whole=True,
        shown="",
    )
    cooperation: Path | None = sink(
        "What cameras were asked, and what they said (Parquet).", "cooperation", asked="also"
    )
    answer_delay: float | Path | None = source(
        "Cameras' answers take so long, or as long as the slowest router in the delays of `occlog traffic`, "
        "of one case (Parquet). [default: no time]",
        number=0.0,
        metavar="SECONDS|FILE",
    )
    labelled_only: bool = setting(
        False, "Do not use candidates that are not assigned to a target.", option="--labelled-only", shown=""
    )
    use_recovered: bool = setting(
        False,
        "Use what the fusion of detections recovered as if it had been measured. [default: not seen]",
        option="--use-recovered",
        shown="",
    )
    in_turn: float | None = setting(
        None,
        "Use one sensor at a time, each for so long, in the order of the scene. [default: all at once]",
        unit="s",
        above=0,
        at_most=LONGEST_S,
        option="--in-turn",
        metavar="SECONDS",
        shown="",
    )
    motion: Path | None = source("How targets move, from `occlog fit-motion`.")

    @property
    def inputs(self) -> list[Path]:
        """Every file that is read."""
        delays = self.answer_delay if isinstance(self.answer_delay, Path) else None
        own = (self.bearings, self.scene, self.doa, self.occluders, self.motion, delays)
        return [path for path in (*own, self.measurements, self.path_loss) if path is not None]


@dataclass(frozen=True, kw_only=True)
class TrackPeopleRequest(TrackRequestBase):
    """Boxes of all cameras to follow people by."""

    RUN: ClassVar[str] = "occlog.track.people.run:run_track_people"
    JUDGED: ClassVar[bool] = True

    doa: Path | None = source("Directions of arrival to use too: a table, or a recording that holds them.")
    support: Path | None = sink("Which box of which camera speaks for which row (Parquet).", "support")
    events: Path | None = sink("Births, deaths, and identities that may have been exchanged (Parquet).", "events")
    gallery: Path | None = source(
        "How people look (Parquet, of `occlog appearance learn`): tracks get its identities, and parts of "
        "somebody who was lost and found are one track."
    )
    view_tracks: Path | None = sink(
        "Everybody in every image, hidden people too (Parquet).", "view_tracks", asked="also"
    )


@dataclass(frozen=True, kw_only=True)
class SingleViewRequest(TrackRequestBase):
    """Boxes to follow in each camera on its own."""

    RUN: ClassVar[str] = "occlog.track.single_view.run:run_track_single_view"

    output: Path = output_file("Tracks (Parquet).", "boxes", result="tracks")


@dataclass(frozen=True, kw_only=True)
class ReadsRequest(_InWorld):
    """Reads of tags to locate these by."""

    RUN: ClassVar[str] = "occlog.track.methods.readers.run:run_track_reads"

    sights: Path | None = source(
        "Bearings of the cameras of --refine: a table, or a recording. [default: those of the recording]"
    )
    virtual_sensors: Path | None = sink(
        "The regions that sets of readers cover, with area, centroid and covariance (Parquet).",
        "virtual_sensors",
        asked="also",
    )


@dataclass(frozen=True, kw_only=True)
class ViewsRequest(TrackRequestBase):
    """A recording to track in the images of."""

    RUN: ClassVar[str] = "occlog.track.methods.images.run.run:run_track_views"

    output: Path = output_file("Tracks (Parquet).", "view_tracks")
    initial: Path | None = source(
        "Where targets are in each view at first: CSV of ellipses, or boxes with identities (Parquet, or "
        "a recording that holds true boxes). [default: from detections]"
    )
    detections: Path | None = source(
        "Boxes of a detector, or views of `occlog detect`, that trackers begin from. [default without "
        "--initial: boxes in the recording, or else what moves in it]"
    )
    fundamental: Path | None = source(
        "Fundamental matrices (JSON, see `occlog epipolar`). [default: poses of --scene, "
        "those in the recording, poses of its scene]"
    )
    world: Path | None = sink(
        "Where the targets are on the ground, from all views that track them (Parquet).", "tracks", asked="also"
    )

    @property
    def births(self) -> str:
        """Where trackers come from: `initial`, `detections` or `both`."""
        if self.initial is None:
            return "detections"
        return "initial" if self.detections is None else "both"
