"""Request of `occlog appearance`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from occlog.request import Request, Verbs, group, output_file, scene_file, source
from occlog.settings import option_setting

from .config import LearnConfig


@dataclass(frozen=True, kw_only=True)
class LearnRequest(Request):
    """Learn an appearance gallery from RECORDING: the colours of each target by viewing angle.

    The viewing angle is the angle between the heading of a person, from the tracks, and the direction to the camera;
    left and right are not distinguished. A box is of the track at its position, unless boxes bring the tracks'
    identities.

    \b
      occlog appearance learn hall.mcap -o gallery.parquet
      occlog appearance learn hall.mcap --boxes boxes.parquet --tracks tracks.parquet -o gallery.parquet
      occlog appearance learn hall.mcap --views views.parquet --tracks tracks.parquet -o gallery.parquet
    """

    OWNER: ClassVar[str] = "appearance learn"
    RUN: ClassVar[str] = "occlog.measure.appearance.run:run_learn"

    recording: Path = source("Recording with images.", argument=True)
    output: Path = output_file(
        "Appearance gallery (Parquet): mean colour histogram of each target and viewing angle.", "gallery"
    )
    boxes: Path | None = source("Boxes of people (Parquet), to learn the colours of. [default: those of RECORDING]")
    views: Path | None = source(
        "Views of `occlog detect` (Parquet) in place of boxes; their stored colours are used, not images."
    )
    tracks: Path | None = source(
        "Tracks or truth: positions and identities of people. [default: truth of RECORDING, or positions on "
        "the floor of boxes with an identity]"
    )
    labelled: bool = option_setting(
        False,
        "Use the identities of the boxes, which are numbered as the tracks are, "
        "instead of associating boxes and tracks by position.",
        shown="",
    )
    scene: Path | None = scene_file("the lenses and poses of the cameras")
    settings: Mapping[str, object] = group(lambda: LearnConfig)


VERBS = Verbs(
    """Learn an appearance gallery for `occlog label --gallery` ([Lee] Sec. 5.2.1).

    \b
      occlog appearance learn hall.mcap --tracks tracks.parquet -o gallery.parquet
      occlog label later.mcap --gallery gallery.parquet --tracks later.parquet -o matches.parquet
    """,
    {"learn": (LearnRequest, "Learn a gallery from boxes and their images.")},
)
