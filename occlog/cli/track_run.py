"""What `occlog track` does: read, track, write."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError, UsageError
from ..io.motion_file import read_motion
from ..io.parquet import TableWriter
from ..io.provenance import Provenance, hash_inputs
from ..records import Bearings, Calibration, Cooperation, Diagnostics, Tracks
from ..stages.fuse_input import only_measured
from ..stages.scans import checked
from ..stages.sources import in_turn
from ..stages.track import choose_sensors, track
from ..trackers import tracker
from ..trackers.imm_config import START_NUMBERS, imm_defaults
from ..trackers.method import sensor_names
from ..trackers.select import SelectConfig
from ..trackers.settings import configure
from . import options
from .track_input import Inputs
from .track_summary import Tally

if TYPE_CHECKING:
    from ..columns import Table
    from ..losses import Loss
    from ..scene import Scene

LONGEST_WINDOW_S = 1e9
METRES = {"m": 1.0, "ft": 0.3048, "in": 0.0254}


@dataclass(frozen=True)
class Request:
    """What to track and how."""

    bearings: Path
    scene: Path | None
    doa: Path | None
    method: str
    settings: dict[str, str]
    starts: tuple[str, ...]
    targets: tuple[int, ...]  # empty: all
    unlabelled: bool
    only: tuple[str, ...]  # sensors; empty: all
    without: tuple[str, ...]
    window_ns: int
    seed: int
    occluders: Path | None = None
    policy: str | None = None  # of the selection of cameras; None: no selection
    selection: dict[str, Any] = field(default_factory=dict)
    order: tuple[str, ...] = ()
    doa_labels: bool = False
    turn_s: float | None = None  # one sensor at a time, for so long; None: all of them
    motion: Path | None = None  # a fitted motion model, for --method map
    use_recovered: bool = False  # of fused bearings also those that were recovered


@dataclass(frozen=True)
class Outputs:
    """What to write."""

    tracks: Path
    diagnostics: Path | None = None
    calibration: Path | None = None
    cooperation: Path | None = None

    @property
    def paths(self) -> list[Path | None]:
        """All of them."""
        return [self.tracks, self.diagnostics, self.calibration, self.cooperation]


def run_track(
    request: Request, wanted: Outputs, overwrite: bool, quiet: bool
) -> tuple[dict[str, Any], tuple[Loss, ...]]:
    """Track and write; the summary, and what had been lost before."""
    inputs = Inputs(request.bearings, request.scene, request.doa, request.doa_labels, request.occluders)
    config = make_config(request, inputs.scene.length_unit)
    if wanted.calibration is not None and getattr(config, "calibrate", "none") == "none":
        raise UsageError("--calibration wants estimates to write; add --set calibrate=joint or --set calibrate=initial")
    sensors = choose_sensors(inputs.scene, request.only, request.without)
    targets = request.targets or None
    selection = make_selection(request)
    chunks = options.progress(inputs.chunks, "track", quiet=quiet)
    if not request.use_recovered:
        chunks = only_measured(chunks)
    if request.turn_s is not None:
        chunks = one_at_a_time(chunks, inputs.scene, sensors, request.turn_s)
    tracked = track(
        chunks, inputs.scene, config, request.seed,
        method=request.method, sensors=sensors, targets=targets, unlabelled=request.unlabelled,
        window_ns=request.window_ns, occluders=inputs.occluders, selection=selection,
    )  # fmt: skip
    parameters = {
        "method": request.method, "sensors": sorted(sensors), "targets": targets, "unlabelled": request.unlabelled,
        "window_ns": request.window_ns, "in_turn_s": request.turn_s, "doa_labels": request.doa_labels,
        "selection": None if selection is None else asdict(selection), **asdict(config),
        **({"use_recovered": True} if request.use_recovered else {}),
    }  # fmt: skip
    paths = [
        p for p in (request.bearings, request.scene, request.doa, request.occluders, request.motion) if p is not None
    ]
    losses = tuple(inputs.losses)
    provenance = Provenance("track", parameters, request.seed, hash_inputs(paths), losses)
    outputs: list[tuple[Path | None, type[Table]]] = [
        (wanted.tracks, Tracks), (wanted.diagnostics, Diagnostics), (wanted.calibration, Calibration),
        (wanted.cooperation, Cooperation),
    ]  # fmt: skip
    tally = Tally()
    with ExitStack() as stack:
        writers = [
            None if p is None else stack.enter_context(
                TableWriter(p, t, provenance, overwrite=overwrite, length_unit=inputs.scene.length_unit)
            )
            for p, t in outputs
        ]  # fmt: skip
        for part in tracked:
            tables = (part.tracks, part.diagnostics, part.calibration, part.cooperation)
            for writer, table in zip(writers, tables, strict=True):
                if writer is not None and table is not None:
                    writer.write(table)
            tally.add(part)
        if not tally.rows and request.method != "imm":
            remedy = "a fix wants directions of two sensors at one time (--window)" if request.method == "fix" else ""
            what = "no row is of the chosen targets and sensors"
            raise InputError(f"{request.bearings}: {what}; {remedy or 'choose others'}")
    for line in tally.warnings():
        options.note(f"warning: {line}", quiet)
    return {"tracks": str(wanted.tracks), "method": request.method, **tally.summary()}, losses


def one_at_a_time(
    chunks: Iterable[Bearings], scene: Scene, sensors: frozenset[str], seconds: float
) -> Iterator[Bearings]:
    """The rows of the sensors in turn, in the order of the scene; those without a pose have no turn."""
    blind = {c.name for c in scene.cameras if not c.placed}
    names = [n for n in sensor_names(scene) if n in sensors and n not in blind]
    if not names:
        raise UsageError("no sensor with a pose is left to take turns; leave out fewer of them")
    return in_turn(checked(chunks, scene, sensors), names, seconds)


def make_config(request: Request, unit: str) -> Any:
    """Settings of the method: its defaults for the length unit, and what the options say."""
    defaults = tracker(request.method).defaults(unit)
    values: dict[str, Any] = dict(request.settings)
    if request.motion is not None:
        values |= motion_settings(request.motion, unit, values)
    if request.starts:
        if "start" in values:
            raise UsageError("--start and --set start=... say the same; give one of them")
        values["start"] = parse_starts(request.starts, request.method, unit)
    try:
        return configure(defaults, values, request.method)
    except InputError as error:  # here the values are options
        raise UsageError(str(error)) from error


def motion_settings(path: Path, unit: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Settings of a motion model in a file; UsageError for another unit, or for settings that say the same."""
    motion = read_motion(path)
    if motion.length_unit != unit:
        raise UsageError(f"{path}: is in {motion.length_unit}, but the scene in {unit}; fit a model in this scene")
    for name in ("A", "Sigma", "step_s", "acceleration", "jitter"):
        if name in given:
            raise UsageError(f"--motion and --set {name}=... both say how targets move; give one of them")
    A, sigma = tuple(motion.A.ravel().tolist()), tuple(motion.sigma.ravel().tolist())
    return {"A": A, "Sigma": sigma, "step_s": motion.step_s}


def make_selection(request: Request) -> SelectConfig | None:
    """How cameras are selected; UsageError for options of a selection without --select."""
    if request.policy is None:
        if request.selection or request.order:
            raise UsageError("--count, --every, --select-model and --select-order go with --select; add it")
        return None
    if request.order and request.policy != "fixed":
        raise UsageError(f"--select-order goes with --select fixed, not {request.policy}")
    try:
        return SelectConfig(policy=request.policy, order=request.order, **request.selection)
    except InputError as error:  # here the values are options
        raise UsageError(str(error)) from error


def parse_names(text: str) -> tuple[str, ...]:
    """Names separated by commas."""
    return tuple(part.strip() for part in text.split(",") if part.strip())


def parse_window(seconds: float) -> int:
    """Nanoseconds; UsageError for what is not finite or longer than times can be apart."""
    return round(parse_seconds("--window", seconds) * 1e9)


def parse_seconds(option: str, seconds: float) -> float:
    """The seconds; UsageError for what is not a number or longer than times can be apart."""
    if seconds != seconds:
        raise UsageError(f"{option} {seconds}: must be a number")
    if not seconds <= LONGEST_WINDOW_S:
        raise UsageError(f"{option} {seconds}: must be at most {LONGEST_WINDOW_S:g} seconds")
    return seconds


def parse_setting(text: str) -> tuple[str, str]:
    """NAME=VALUE."""
    name, equals, value = text.partition("=")
    if not equals or not name.strip():
        raise UsageError(f"--set {text}: want NAME=VALUE")
    return name.strip(), value


def parse_starts(texts: tuple[str, ...], method: str, unit: str) -> str:
    """The starts as the method's setting; UsageError for several where the method has one filter a target."""
    if method == "imm":
        return ",".join(_with_velocity(text, unit) for text in texts)
    if len(texts) > 1:
        raise UsageError(f"--start says where one target is; give it once, or use --method imm (method {method})")
    return parse_start(texts[0], unit)


def _with_velocity(text: str, unit: str) -> str:
    """X,Y,SIGMA,VX,VY,SIGMA_V; at rest up to the method's usual speed where the velocity is left out."""
    parts = text.split(",")
    if len(parts) == START_NUMBERS:
        return text
    if len(parts) > 3:
        raise UsageError(f"--start {text}: want X,Y, X,Y,SIGMA or X,Y,SIGMA,VX,VY,SIGMA_V")
    return f"{parse_start(text, unit)},0,0,{imm_defaults(unit).speed}"


def parse_start(text: str, unit: str) -> str:
    """X,Y,SIGMA of X,Y[,SIGMA]; half a metre, or 1 in a scene with units of its own, where SIGMA is left out."""
    parts = text.split(",")
    if len(parts) == 2:
        parts.append(str(0.5 / METRES[unit] if unit in METRES else 1.0))
    if len(parts) != 3:
        raise UsageError(f"--start {text}: want X,Y or X,Y,SIGMA")
    return ",".join(parts)
