"""Request of `occlog priors`, for each source of moving occluders."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from occlog.request import Request, Verbs, group, output_file, scene_file, seed_of_all, sink, source
from occlog.settings import option_setting

from .config import AcousticConfig, HullConfig, PositionPriorConfig


@dataclass(frozen=True, kw_only=True)
class KalmanRequest(Request):
    """Estimate occluder priors from POSITIONS (truth or tracks: a table or a recording) by Kalman filters.

    Of truth the objects of the role `occluder` are used. Without --measured, noise is added to their true positions
    first, as in experiments with virtual occluders.

    \b
      occlog priors kalman room.mcap -o occluders.parquet --measurement-noise 8 --process-noise 1.2 --seed 1
      occlog priors kalman badges.parquet --measured --measurement-noise 0.2 -o occluders.parquet
    """

    OWNER: ClassVar[str] = "priors"
    RUN: ClassVar[str] = "occlog.measure.priors.run:run_kalman"

    positions: Path = source("Truth or tracks.", argument=True)
    output: Path = output_file(
        "Occluder priors: mean and covariance of each occluder at each time (Parquet).", "occluders"
    )
    scene: Path | None = source("Scene (YAML or a recording), of which only the length unit is used.", scene=True)
    measured: bool = option_setting(False, "POSITIONS are real measurements: no noise is added.", shown="")
    settings: Mapping[str, object] = group(lambda: PositionPriorConfig)
    without: tuple[int, ...] = option_setting(
        (), "Leave out the object with this identity; may be repeated.", metavar="ID", repeat=True, shown=""
    )
    seed: int = seed_of_all()


@dataclass(frozen=True, kw_only=True)
class HullRequest(Request):
    """Estimate occluder priors from VIEWS (of `occlog detect --views`): visual hulls of all silhouettes.

    Polygons that no camera needs (phantoms) are omitted. Where clusters are not distinguished, the polygon of the
    tracked target is among them: `occlog track --set own_prior_gate=3` leaves it out.

    \b
      occlog priors hull views.parquet --scene hall.mcap -o occluders.parquet --hulls hulls.parquet
    """

    OWNER: ClassVar[str] = "priors"
    RUN: ClassVar[str] = "occlog.measure.priors.run:run_hull"

    views: Path = source("Views of cameras.", argument=True)
    output: Path = output_file(
        "Occluder priors: mean and covariance of each polygon at each time (Parquet).", "occluders"
    )
    hulls: Path | None = sink("Also write the polygons of the visual hulls (Parquet).", "hulls")
    scene: Path | None = scene_file("the lenses and poses of the cameras")
    bearings: Path | None = source(
        "Bearings made along with VIEWS, which distinguish frames without people from missing frames."
    )
    cameras: tuple[str, ...] = option_setting((), "Use these cameras only.", metavar="A,B,...", shown="")
    without: tuple[str, ...] = option_setting((), "Exclude these cameras.", metavar="A,B,...", shown="")
    settings: Mapping[str, object] = group(lambda: HullConfig, example="max_speed=2")


@dataclass(frozen=True, kw_only=True)
class AcousticRequest(Request):
    """Estimate occluder priors from DOA, directions of arrival at two arrays or more (a table or a recording).

    \b
      occlog priors acoustic talk.mcap -o occluders.parquet --window 0.05
    """

    OWNER: ClassVar[str] = "priors"
    RUN: ClassVar[str] = "occlog.measure.priors.run:run_acoustic"

    doa: Path = source("Directions of arrival.", argument=True)
    output: Path = output_file(
        "Occluder priors: mean and covariance of each occluder at each time (Parquet).", "occluders"
    )
    scene: Path | None = scene_file()
    settings: Mapping[str, object] = group(lambda: AcousticConfig, example="min_triangulation_angle=0.2")


VERBS = Verbs(
    """Estimate the positions of moving occluders, for `occlog track --occluders`.

    \b
      occlog priors kalman room.mcap -o occluders.parquet
      occlog track room.mcap -o tracks.parquet --occluders occluders.parquet
    """,
    {
        "kalman": (KalmanRequest, "From positions, true or measured."),
        "hull": (HullRequest, "From the views of several cameras: their visual hull."),
        "acoustic": (AcousticRequest, "From directions of arrival at microphone arrays."),
    },
)
