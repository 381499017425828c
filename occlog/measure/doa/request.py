"""Request of `occlog listen`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from occlog.ingest.plan import pairs
from occlog.request import Request, group, output_file, scene_file, source
from occlog.settings import option_setting, setting

from .config import DoaConfig


@dataclass(frozen=True, kw_only=True)
class DoaRequest(Request):
    """Estimate directions of arrival in the sound of microphone arrays (WAV, one channel per microphone).

    The positions of the microphones are those of the array in the scene (`microphones`), or of --arrays, by the name
    of the array before =. Each frame of sound gives the directions of its sources in the world frame, with standard
    deviations and the agreement of the phases; silence gives none. A flat array does not distinguish above from
    below: it gives the direction above.
    Needs the package pyroomacoustics: pip install pyroomacoustics.

    \b
      occlog listen --scene hall.yaml mic1=mic1.wav mic2=mic2.wav -o doa.parquet --start-time 2024-05-01T12:00:00Z
      occlog listen --arrays desk=microphones.csv desk=talk.wav -o doa.parquet --max-sources auto --min-snr 10
    """

    OWNER: ClassVar[str] = "listen"
    RUN: ClassVar[str] = "occlog.measure.doa.run:run_listen"

    sounds: tuple[Path, ...] = source(
        "Sound files of an array.", argument=True, there=False, metavar="[ARRAY=]FILE.wav..."
    )
    output: Path = output_file("Directions of arrival (Parquet).", "doa")
    scene: Path | None = scene_file("the microphone arrays")
    arrays: tuple[str, ...] = option_setting(
        (),
        "Positions of the microphones of an array, instead of the scene's: a CSV table x, y, "
        "z [m], a row for each; may be repeated.",
        metavar="[NAME=]FILE",
        repeat=True,
        whole=True,
        shown="",
    )
    channels: tuple[str, ...] = option_setting(
        (),
        "Numbers of the channels of the sound files, from 1, separated by commas, in the "
        "order of the microphones. [default: all]",
        metavar="A,B,...",
        shown="",
    )
    start_time: tuple[str, ...] = option_setting(
        (),
        "Date and time (ISO 8601, UTC) or seconds since 1970 of the first sample. [default: 0]",
        metavar="[ARRAY=]TIME",
        repeat=True,
        whole=True,
        shown="",
    )
    source_limit: str | None = setting(
        None,
        "Maximum number of directions per frame; auto: all peaks (srp). [default: 1]",
        option="--max-sources",
        metavar="N|auto",
        shown="",
    )
    band: tuple[float, ...] | None = option_setting(
        None,
        "Lowest and highest frequency to use [Hz]. [default: 300 4000]",
        unit="Hz",
        counts=(2,),
        apart=True,
        metavar="LOW HIGH",
        shown="",
    )
    settings: Mapping[str, object] = group(lambda: DoaConfig)

    @property
    def inputs(self) -> list[Path]:
        """Every file that is read."""
        scene = [] if self.scene is None else [self.scene]
        sounds, arrays = pairs(map(str, self.sounds), Path), pairs(self.arrays, Path)
        return [*(path for _, path in sounds), *scene, *(path for _, path in arrays)]
