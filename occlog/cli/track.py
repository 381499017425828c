"""The `occlog track` command."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..errors import UsageError
from . import options

if TYPE_CHECKING:
    from ..io.provenance import Provenance
    from ..losses import Loss
    from ..records import Bearings
    from ..stages.track import Tracked

METHODS = ("apf",)
"""Names of `occlog.trackers.TRACKERS`; a test keeps the two alike, so that --help need not load the trackers."""


@click.command(name="track", short_help="Estimate target tracks from bearings.")
@click.argument("bearings", type=options.PATH)
@options.output_opt("Tracks (Parquet).")
@click.option("--diagnostics", type=options.PATH, default=None, help="How the filter fared at each time (Parquet).")
@options.scene_opt
@click.option("--method", type=click.Choice(METHODS), default="apf", show_default=True, help="Tracking method.")
@click.option("--particles", type=click.IntRange(min=1), default=None, help="Particles a target. [default: 1000]")
@click.option(
    "--start", default=None, metavar="X,Y[,SIGMA]", help="Where the target is at first. [default: anywhere in the room]"
)
@click.option("--cameras", "only", default="", metavar="A,B,...", help="Use only these sensors.")
@click.option("--without", default="", metavar="A,B,...", help="Leave these sensors out.")
@click.option(
    "--window", type=click.FloatRange(min=0), default=0.0, metavar="SECONDS",
    help="Measurements this close together in time make one scan. [default: equal times]",
)  # fmt: skip
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="NAME=VALUE",
    help="A setting of the method, e.g. sigma_v=0.3; may be repeated.",
)
@options.seed_opt
@options.overwrite_opt
@options.quiet_opt
@options.json_opt
def command(
    bearings: Path, output: Path, diagnostics: Path | None, scene: Path | None, method: str, particles: int | None,
    start: str | None, only: str, without: str, window: float, settings: tuple[str, ...], seed: int, overwrite: bool,
    quiet: bool, as_json: bool,
) -> int:  # fmt: skip
    """Estimate target tracks from BEARINGS (Parquet, or a recording that holds bearings).

    Each labelled target has its own filter. Candidates without a label (target_id -1, for example
    a detector's boxes) make one track, of the target at --start if that is given.
    The same inputs, options and seed give the same output.

    \b
      occlog track bearings.parquet --scene scene.yaml -o tracks.parquet --diagnostics diagnostics.parquet
      occlog track bearings.parquet --scene hall.mcap --without cam4 --start 4,1.5,0.5 -o without4.parquet
    """
    options.check_outputs([bearings, scene], [output, diagnostics], overwrite)
    values = dict(_setting(text) for text in settings)
    if particles is not None:
        values["particles"] = str(particles)
    if start is not None:
        values["start"] = _start(start)
    request = Request(bearings, scene, method, values, _names(only), _names(without), round(window * 1e9), seed)
    summary, losses = run_track(request, output, diagnostics, overwrite, quiet)
    return options.finish(summary, losses, as_json)


@dataclass(frozen=True)
class Request:
    """What to track and how."""

    bearings: Path
    scene: Path | None
    method: str
    settings: dict[str, str]
    only: tuple[str, ...]
    without: tuple[str, ...]
    window_ns: int
    seed: int


def _names(text: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in text.split(",") if part.strip())


def _setting(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals or not name.strip():
        raise UsageError(f"--set {text}: want NAME=VALUE")
    return name.strip(), value


def _start(text: str) -> str:
    parts = text.split(",")
    if len(parts) == 2:
        parts.append("1.0")
    if len(parts) != 3:
        raise UsageError(f"--start {text}: want X,Y or X,Y,SIGMA")
    return ",".join(parts)


def run_track(
    request: Request, output: Path, diagnostics: Path | None, overwrite: bool, quiet: bool
) -> tuple[dict[str, Any], tuple[Loss, ...]]:
    """Track and write; the summary, and what had been lost before."""
    from ..io.parquet import TableWriter
    from ..io.provenance import Provenance, hash_inputs
    from ..records import Diagnostics, Tracks
    from ..stages.track import choose_sensors, track
    from ..trackers import tracker
    from ..trackers.settings import configure

    chunks, earlier, scene = _inputs(request)
    defaults = tracker(request.method).defaults(scene.length_unit)
    config = configure(defaults, request.settings, request.method)
    sensors = choose_sensors(scene, request.only, request.without)
    parameters = {
        "method": request.method,
        "sensors": sorted(sensors),
        "window_ns": request.window_ns,
        **asdict(config),
    }
    paths = [p for p in (request.bearings, request.scene) if p is not None]
    provenance = Provenance("track", parameters, request.seed, hash_inputs(paths), earlier.losses)
    tracked = track(
        options.progress(chunks, "track", quiet=quiet), scene, config, request.seed,
        method=request.method, sensors=sensors, window_ns=request.window_ns,
    )  # fmt: skip
    tally = Tally()
    with ExitStack() as stack:
        unit = scene.length_unit
        tables = stack.enter_context(TableWriter(output, Tracks, provenance, overwrite=overwrite, length_unit=unit))
        more = None
        if diagnostics is not None:
            more = stack.enter_context(
                TableWriter(diagnostics, Diagnostics, provenance, overwrite=overwrite, length_unit=unit)
            )
        for part in tracked:
            tables.write(part.tracks)
            if more is not None:
                more.write(part.diagnostics)
            tally.add(part)
    return {"tracks": str(output), **tally.summary()}, earlier.losses


def _inputs(request: Request) -> tuple[Iterable[Bearings], Provenance, Any]:
    """Bearings in chunks, how they were made, and the scene."""
    from ..records import Bearings

    if request.bearings.suffix.lower() == ".mcap":
        from ..io.recording import open_recording

        recording = open_recording(request.bearings)
        if not recording.has(Bearings):
            raise UsageError(f"{request.bearings}: holds no bearings; make them with `occlog detect`")
        scene = options.load_scene(request.scene, recording.scene, request.bearings)
        return recording.tables(Bearings), recording.provenance, scene
    from ..io.parquet import iter_table, read_provenance

    scene = options.load_scene(request.scene, None, request.bearings)
    return _named(iter_table(request.bearings, Bearings), request.bearings), read_provenance(request.bearings), scene


def _named(chunks: Iterator[Bearings], path: Path) -> Iterator[Bearings]:
    """The chunks; refuses a table without rows, from which nothing can be tracked."""
    from ..errors import InputError

    rows = 0
    for chunk in chunks:
        rows += len(chunk)
        yield chunk
    if rows == 0:
        raise InputError(f"{path}: has no rows; nothing can be tracked from it")


class Tally:
    """Figures of the summary, gathered while streaming."""

    def __init__(self) -> None:
        """Nothing yet."""
        self.rows = 0
        self.targets: set[int] = set()
        self.fallbacks: Counter[str] = Counter()
        self.ess = 0.0

    def add(self, part: Tracked) -> None:
        """Count some more rows."""
        self.rows += len(part.tracks)
        self.targets.update(int(i) for i in part.tracks.target_id)
        self.fallbacks.update(str(f) for f in part.diagnostics.fallback if f)
        self.ess += float(part.diagnostics.ess.sum())

    def summary(self) -> dict[str, Any]:
        """The figures."""
        return {
            "targets": len(self.targets),
            "rows": self.rows,
            "mean_effective_particles": self.ess / self.rows if self.rows else None,
            "fallbacks": dict(sorted(self.fallbacks.items())),
        }
