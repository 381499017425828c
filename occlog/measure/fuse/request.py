"""Request of `occlog fuse`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from occlog.request import Form, Request, Verb, VerbKind, group, output_file, scene_file, sink, source

from .config import FuseConfig
from .tracks.config import TrackFusionConfig

DETECTIONS, TRACKS = "detections", "tracks"


@dataclass(frozen=True, kw_only=True)
class FuseRequestBase(Request):
    """Fuse the detections of several cameras in BEARINGS (Parquet, or a recording that holds bearings).

    Detections of one target are combined on the ground. Where enough cameras agree, a camera that missed the target
    gets its detection back (cause `recovered`); a detection that the others contradict becomes a missed one (cause
    `removed`). Candidates (target_id -1) are grouped first. `occlog detect --fuse` does the same during detection.

    With --with, BEARINGS and the other files are tracks of several groups of cameras in one world: the tracks of one
    person become one track, with one identity, by covariance intersection.

    \b
      occlog fuse bearings.parquet --views views.parquet --scene walk.mcap -o fused.parquet --fused-views both.parquet
      occlog fuse labelled.parquet --scene hall.mcap -o fused.parquet --miss-probability 0.3
      occlog fuse east.parquet --with west.parquet -o hall.parquet --events hall_events.parquet
    """

    OWNER: ClassVar[str] = "fuse"

    bearings: Path = source("Detections of targets, or candidates.", argument=True)
    output: Path = output_file("Fused bearings, or with --with fused tracks (Parquet).", "bearings")


@dataclass(frozen=True, kw_only=True)
class FuseRequest(FuseRequestBase):
    """Request to fuse detections of several cameras."""

    RUN: ClassVar[str] = "occlog.measure.fuse.run:run_fuse"

    views: Path | None = source("Views that the bearings were made from (Parquet).")
    fused_views: Path | None = sink(
        "Write the views after the fusion (Parquet).", "views", result="views", asked="views"
    )
    scene: Path | None = scene_file("the lenses and poses of the cameras")
    settings: Mapping[str, object] = group(lambda: FuseConfig, example="process_noise_density=2")


@dataclass(frozen=True, kw_only=True)
class TrackFusionRequest(FuseRequestBase):
    """Request to fuse tracks of several groups of cameras."""

    RUN: ClassVar[str] = "occlog.measure.fuse.tracks.run:run_fuse_tracks"

    output: Path = output_file("Fused bearings, or with --with fused tracks (Parquet).", "tracks")
    others: tuple[Path, ...] = source(
        "Tracks of another group of cameras (Parquet); may be repeated.",
        required=True,
        option="--with",
        metavar="TRACKS",
    )
    events: Path | None = sink(
        "Write track initiations, terminations and possible identity switches (Parquet).", "events"
    )
    settings: Mapping[str, object] = group(lambda: TrackFusionConfig, example="max_gap_s=2")


VERB = Verb(
    FuseRequestBase,
    {
        DETECTIONS: VerbKind("Detections of several cameras.", lambda: Form(FuseRequest), "fuse BEARINGS"),
        TRACKS: VerbKind(
            "Tracks of several groups of cameras.", lambda: Form(TrackFusionRequest), "fuse TRACKS --with TRACKS"
        ),
    },
    default=DETECTIONS,
    by={"with": lambda _: TRACKS},
    chosen_by="fuse [--with TRACKS]",
    example="process_noise_density=2",
)
