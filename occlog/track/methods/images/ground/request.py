"""What `occlog ground` takes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from occlog.request import Request, group, output_file, scene_file, source
from occlog.settings import option_setting

from .config import GroundConfig


@dataclass(frozen=True, kw_only=True)
class GroundRequest(Request):
    """Triangulate the targets of VIEW_TRACKS (Parquet) to the ground plane, with covariance.

    At each time step the centres of the ellipses of a target in all views give its position. A view that is on
    something else is omitted if two or more others agree; two views that contradict each other give no position. A
    target in a single view is located at a height, that of the centre of a person; set another, or 0 to leave such
    times out.

    \b
      occlog ground view_tracks.parquet --scene scene.yaml -o tracks.parquet
      occlog ground view_tracks.parquet --scene hall.mcap --set target_height=0 -o tracks.parquet
    """

    OWNER: ClassVar[str] = "ground"
    RUN: ClassVar[str] = "occlog.track.methods.images.ground.run:run_ground"

    view_tracks: Path = source("Tracks in images.", argument=True)
    output: Path = output_file("Tracks (Parquet).", "tracks")
    scene: Path | None = scene_file("the lenses and poses of the cameras")
    cameras: tuple[str, ...] = option_setting((), "Use these cameras only.", metavar="A,B,...", shown="")
    settings: Mapping[str, object] = group(lambda: GroundConfig, example="target_height=0.8")
