"""What `occlog fit-motion` takes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from occlog.request import Request, group, output_file, source
from occlog.settings import setting

from .config import FitConfig


@dataclass(frozen=True, kw_only=True)
class FitMotionRequest(Request):
    """Fit a linear Gaussian motion model to POSITIONS: truth or tracks, tables or recordings.

    The model is x' = A x + process noise of covariance Sigma, with x the position and velocity of both axes.
    Positions may be noisy, at unequal times and with gaps; measurement noise is separated from process noise.

    \b
      occlog fit-motion room.mcap -o motion.json --step 0.25
      occlog fit-motion monday.parquet tuesday.parquet -o motion.json --form damped --measurement-noise 0.1
    """

    OWNER: ClassVar[str] = "fit-motion"
    RUN: ClassVar[str] = "occlog.track.methods.map.fit_motion.run:run_fit"

    positions: tuple[Path, ...] = source("Truth or tracks.", argument=True)
    output: Path = output_file("The motion model (JSON).")
    settings: Mapping[str, object] = group(lambda: FitConfig)
    targets: tuple[int, ...] = setting(
        (),
        "Use this object only; may be repeated. [default: all; of truth those with the role target]",
        option="--target",
        metavar="ID",
        repeat=True,
        shown="",
    )
