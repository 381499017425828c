"""Request of `occlog epipolar`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from occlog.request import Request, group, scene_file, sink, source
from occlog.settings import option_setting

from .config import EpipolarConfig


@dataclass(frozen=True, kw_only=True)
class EpipolarRequest(Request):
    """Estimate the fundamental matrix of each pair of views, which maps a point to its epipolar line, or check it.

    It comes from --matches (or --from-tracks) if given, else from the camera poses (extrinsics) of the scene. Matches
    from one plane (people's feet), from a line, from one position, or too few are refused. Lens distortion that a
    scene states is removed from the points first.

    With RECORDING and an output that ends in .mcap, a copy of the recording holds the matrices, and `occlog track`
    finds them there.

    \b
      occlog epipolar --scene scene.yaml -o epipolar.json
      occlog epipolar --matches matches.csv -o epipolar.json
      occlog epipolar walk.mcap --matches matches.csv -o walk_epipolar.mcap
      occlog epipolar --check --matches matches.csv --fundamental epipolar.json
    """

    OWNER: ClassVar[str] = "epipolar"
    RUN: ClassVar[str] = "occlog.measure.epipolar.run:run_epipolar"
    JUDGED: ClassVar[bool] = True
    VERDICT: ClassVar[str] = "agree"
    STRICT: ClassVar[str] = ""

    recording: Path | None = source("Recording to which the matrices are added.", argument=True, required=False)
    output: Path | None = sink(
        "Fundamental matrices (JSON), or a copy of the recording that holds them (MCAP).", option="-o/--output"
    )
    scene: Path | None = scene_file("the lenses and poses of the cameras")
    matches: Path | None = source(
        "Points that two views share: CSV, sensor_a,sensor_b,xa_px,ya_px,xb_px,yb_px.", metavar="FILE"
    )
    tracks: Path | None = source(
        "Take the centres of targets in two views as matches: view tracks (Parquet), or a recording or table with "
        "true boxes.",
        option="--from-tracks",
        metavar="FILE",
    )
    fundamental: Path | None = source(
        "Fundamental matrices (JSON, or a recording that holds some) to check, or to write, instead of estimating "
        "them.",
        metavar="FILE",
    )
    check: bool = option_setting(
        False, "Write nothing, and report how well the matches agree with the matrices or the poses.", shown=""
    )
    settings: Mapping[str, object] = group(lambda: EpipolarConfig)
    cameras: tuple[str, ...] = option_setting(
        (), "Only pairs of these cameras, names separated by commas.", metavar="A,B,...", shown=""
    )
