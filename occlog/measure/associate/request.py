"""Request of `occlog label`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from occlog.measure.appearance.config import MatchConfig
from occlog.request import Form, Request, Verb, VerbKind, group, output_file, scene_file, sink, source
from occlog.settings import option_setting

from .config import LabelConfig, NamingConfig

BY_TRACKS, BY_GALLERY = "tracks", "gallery"
GALLERY = (
    "Match boxes with this appearance gallery (Parquet, from `occlog appearance learn`), "
    "instead of bearings with tracks."
)


@dataclass(frozen=True, kw_only=True)
class LabelRequestBase(Request):
    """Associate the candidates of BEARINGS (Parquet, or a recording that holds bearings) with tracks, and label them.

    In every frame of a sensor the candidates (target_id -1) are assigned one to one to the tracks, by the difference
    of bearings. A track without a candidate gets a row of a missed detection. Rows that have a label keep it.

    With --gallery BEARINGS holds boxes or views, and each is compared with the appearance of people in the gallery at
    the viewing angle of the camera ([Lee] Sec. 5.2.1). For people missing from the gallery nothing is decided.

    \b
      occlog track boxes.parquet --scene hall.mcap --start 2.9,0.5,0.3 -o tracks.parquet
      occlog label boxes.parquet --scene hall.mcap --tracks tracks.parquet -o labelled.parquet
      occlog label hall.mcap --gallery gallery.parquet --tracks tracks.parquet -o matches.parquet
    """

    OWNER: ClassVar[str] = "label"

    bearings: Path = source("Candidates, or a recording that holds them.", argument=True)
    output: Path = output_file("Labelled bearings; with --gallery a table of matches (Parquet).", "bearings")
    scene: Path | None = scene_file()


@dataclass(frozen=True, kw_only=True)
class _ByKind(LabelRequestBase):
    """Options of `occlog label` that select the kind of request: with a gallery, or without."""

    gallery: Path | None = source(GALLERY)


@dataclass(frozen=True, kw_only=True)
class LabelRequest(LabelRequestBase):
    """Request to label candidates by the positions of tracks."""

    RUN: ClassVar[str] = "occlog.measure.associate.run:run_label"

    tracks: Path = source("Tracks that give the identities (Parquet).", required=True)
    doa: Path | None = source("Directions of arrival to label too: a table, or a recording that holds them.")
    doa_labels: bool = option_setting(False, "Source IDs in the directions of --doa are target IDs.", shown="")
    settings: Mapping[str, object] = group(lambda: LabelConfig)
    cameras: tuple[str, ...] = option_setting((), "Use these sensors only.", metavar="A,B,...", shown="")
    without: tuple[str, ...] = option_setting((), "Exclude these sensors.", metavar="A,B,...", shown="")

    @property
    def inputs(self) -> list[Path]:
        """All files that are read."""
        return [p for p in (self.bearings, self.tracks, self.scene, self.doa) if p is not None]


@dataclass(frozen=True, kw_only=True)
class MatchRequest(LabelRequestBase):
    """Request to label boxes by the appearance of people."""

    RUN: ClassVar[str] = "occlog.measure.associate.run:run_match"

    gallery: Path = source(GALLERY, required=True)
    output: Path = output_file("Labelled bearings; with --gallery a table of matches (Parquet).", "appearance_matches")
    images: Path | None = source("Recording with the images. [default: BEARINGS; views need none]")
    tracks: Path | None = source(
        "Tracks or truth: positions and headings of people. [default: truth of the recording, or the floor below "
        "boxes with an identity]"
    )
    labelled: bool = option_setting(False, "Identities of boxes are those of the tracks.", shown="")
    reidentified: Path | None = sink("Write the tracks with the identities of the gallery (Parquet).", "tracks")
    settings: Mapping[str, object] = group(lambda: MatchConfig)
    naming: Mapping[str, object] = group(lambda: NamingConfig)

    @property
    def inputs(self) -> list[Path]:
        """All files that are read, without duplicates."""
        given = (self.images, self.bearings, self.tracks, self.scene)
        return [*dict.fromkeys(p for p in given if p is not None), self.gallery]


VERB = Verb(
    _ByKind,
    {
        BY_TRACKS: VerbKind(
            "candidates are labelled by the track at their bearing", lambda: Form(LabelRequest), "--tracks FILE"
        ),
        BY_GALLERY: VerbKind(
            "boxes are labelled by the most similar person of the gallery", lambda: Form(MatchRequest), "--gallery FILE"
        ),
    },
    default=BY_TRACKS,
    by={"gallery": lambda _: BY_GALLERY},
)
