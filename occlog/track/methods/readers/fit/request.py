"""What `occlog fit-readers` takes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from occlog.request import Request, group, output_file, scene_file, source

from .config import FitReadersConfig


@dataclass(frozen=True, kw_only=True)
class FitReadersRequest(Request):
    """Fit path loss, shadowing and coverage of tag readers to RECORDINGS with reads and true positions of tags.

    Each reader has its own power at 1 m; exponent, noise and shadowing are common. The range of the virtual sensors
    is the one with the least error. Use the result to track other recordings of the same readers.

    \b
      occlog fit-readers monday.mcap tuesday.mcap -o readers.json
      occlog track wednesday.mcap --method rssi --path-loss readers.json -o tags.parquet
    """

    OWNER: ClassVar[str] = "fit-readers"
    RUN: ClassVar[str] = "occlog.track.methods.readers.fit.run:run_fit_readers"

    recordings: tuple[Path, ...] = source("Recordings with reads and true positions.", argument=True)
    output: Path = output_file("Path loss models and ranges of the readers (JSON), for `occlog track --path-loss`.")
    scene: Path | None = scene_file("the tag readers")
    settings: Mapping[str, object] = group(lambda: FitReadersConfig)
