"""The work of `occlog simulate` but for balls: settings of a request, and a scene to a recording, chunk by chunk."""

from __future__ import annotations

import itertools
import json
import math
from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from occlog import console
from occlog.array_types import Floats
from occlog.cli.setting_options import flag_of
from occlog.console.notes import threads_by_default
from occlog.core.navigation.forces import distance
from occlog.core.navigation.obstacles import MovingObstacleTracks
from occlog.core.numerics.interpolate import TimeGrid
from occlog.errors import InputError, UsageError, option
from occlog.io.files.atomic import OutputGroup, check_outputs
from occlog.io.files.provenance import Provenance
from occlog.io.formats.scenes.paths import read_paths
from occlog.io.open import Opened, load_scene, open_input
from occlog.io.recording.writer import RecordingWriter
from occlog.records.columns import ColumnTable
from occlog.records.scene import MotionScript, Scene
from occlog.records.tables import Tracks, Truth
from occlog.runner import Job, JobResult
from occlog.scans.occluder_priors import PeopleAsObstacles, moving_people
from occlog.settings import SettingError, configure
from occlog.simulate.render.people import reference_appearances
from occlog.simulate.sensors.arrays import observe_arrays
from occlog.simulate.sensors.cameras import observe
from occlog.simulate.sensors.stations import observe_readers, observe_stations
from occlog.simulate.world.people_room import CLEARANCE, people_apart, people_room
from occlog.simulate.world.scripted_paths import check_inside, grid_truth, silences, simulate_paths, truth_grid

from .config import (
    FieldConfig,
    MeasureConfig,
    ObserveConfig,
    PeopleConfig,
    ReadConfig,
    RenderConfig,
    SoundConfig,
    StoreConfig,
    WorldConfig,
)
from .request import KINDS, SceneRequest, SimulatePeopleRequest, SimulateRequestBase
from .stage import simulate_truth
from .video import Setup, film, video_paths

LONGEST_GAP_S = 1.0
"""Longest time between two rows of a person to avoid that is bridged."""
APPEARANCE = "appearance.json"
"""Attachment of a recording: what the targets resemble."""


def run_scene(request: SceneRequest, job: Job) -> JobResult:
    """Simulate a recording of a scene from a file; return the summary."""
    if request.scene is None:
        raise UsageError(
            f"no scene: give SCENE (a file), or {option('scene')} {' or '.join(KINDS)}", id="missing-option"
        )
    if request.scene.name in KINDS and not request.scene.exists():
        name = request.scene
        raise UsageError(
            f"{name}: no such file; the video of {name} is made with {option('scene')} {name}", id="file-not-found"
        )
    scene = load_scene(request.scene, None, request.scene)
    script = None if request.paths is None else read_paths(request.paths)
    return _write(make_setup(scene, request, script), request, job)


def run_people(request: SimulatePeopleRequest, job: Job) -> JobResult:
    """Render the video of people of similar appearance as a recording; return the summary."""
    return _write(people_setup(request), request, job)


def _write(setup: Setup, request: SimulateRequestBase, job: Job) -> JobResult:
    output = request.output
    check_outputs(request.inputs, [output, *video_paths(setup, output).values()], job.overwrite)
    made = job.provenance(parameters(setup), setup.losses, request.seed)
    return JobResult(write_recording(setup, made, output, overwrite=job.overwrite, quiet=job.quiet), setup.losses)


def make_setup(scene: Scene, request: SceneRequest, script: MotionScript | None = None) -> Setup:
    """Resolve the request's settings with scene-dependent defaults; UsageError for conflicting options.

    Args:
        scene: scene; its unit of length determines the defaults.
        request: settings that were given.
        script: scripted paths of targets; None: random walkers.
    """
    if request.fps is not None:
        scene = replace(scene, cameras=tuple(replace(c, rate_hz=request.fps) for c in scene.cameras))
    _check_request(scene, request)
    world = _walkers(scene, request) if script is None else _scripted(scene, request, script)
    observing = not request.render if request.bearings is None else request.bearings
    watch = configure(ObserveConfig(diameter=world.diameter), request.observe) if observing else None
    workers = request.workers or threads_by_default()
    render = configure(RenderConfig(diameter=world.diameter, workers=workers), request.rendering)
    fields = configure(FieldConfig.in_unit(scene.length_unit), request.avoidance)
    avoid = None if request.avoid is None else open_input(request.avoid, Tracks, Truth)
    heights = world.object_height is not None or (script is not None and script.heights)
    return Setup(
        scene=scene,
        world=world,
        observe=watch,
        render=render if request.render else None,
        store=configure(StoreConfig(), request.store),
        sound=configure(SoundConfig(step_s=world.step_s, known_heights=heights), request.sound),
        script=script,
        field=fields if world.motion == "field" else None,
        people=None if avoid is None else _people(avoid, scene, world),
        reads=configure(ReadConfig(), request.reads),
        measure=configure(MeasureConfig.in_unit(scene.length_unit), request.measure),
        losses=() if avoid is None else avoid.losses,
    )


def _people(opened: Opened, scene: Scene, world: WorldConfig) -> MovingObstacleTracks:
    """People of a file whom the simulated walkers avoid, as circles with the diameter of the walkers.

    Args:
        opened: opened file with tracks or truth.
        scene: gives the unit of length.
        world: diameter and time steps.
    """
    taken = PeopleAsObstacles(
        radius=0.5 * world.diameter, sigmas=0.0, max_gap_s=LONGEST_GAP_S, step_s=world.step_s, steps=world.steps
    )
    return moving_people(opened, scene.length_unit, 0.0, taken)


def _check_request(scene: Scene, request: SceneRequest) -> None:
    """UsageError for options that do not apply to this scene or that state one value twice."""
    of_video = [flag_of(RenderConfig, name) for name in request.rendering]
    of_video += [flag_of(StoreConfig, name) for name in request.store]
    if of_video and not request.render:
        raise UsageError(f"{of_video[0]} applies to video; add {option('render')}", id="missing-option")
    if (request.avoidance or request.avoid is not None) and request.world.get("motion") != "field":
        flag = option("avoid") if request.avoid is not None else flag_of(FieldConfig, next(iter(request.avoidance)))
        raise UsageError(
            f"{flag} applies to walkers that avoid obstacles; add {option('motion')} field", id="missing-option"
        )
    if request.sound and not scene.arrays:
        flag = flag_of(SoundConfig, next(iter(request.sound)))
        raise UsageError(
            f"{flag} applies to microphone arrays, but the scene has none; leave it out, or add "
            "`microphone_arrays` to the scene",
            id="too-few-sensors",
        )
    kinds = configure(MeasureConfig(), request.measure).kinds
    if request.reads and not scene.readers and "strength" not in kinds:
        flag = flag_of(ReadConfig, next(iter(request.reads)))
        raise UsageError(
            f"{flag} applies to readers of tags, but the scene has none; leave it out, or add `readers` to the scene",
            id="too-few-sensors",
        )
    if request.measure and not kinds:
        flag = flag_of(MeasureConfig, next(iter(request.measure)))
        raise UsageError(
            f"{flag} applies to measurements of distances; add {option('measure')} range, difference or strength",
            id="missing-option",
        )
    stations = sum(c.placed for c in scene.cameras) + len(scene.arrays)
    if kinds and stations < (2 if kinds == ("difference",) else 1):
        raise UsageError(
            f"{option('measure')} {request.measure['measure']} requires a camera or microphone "
            f"array with a position (difference: two); the scene has {stations}",
            id="too-few-sensors",
        )
    if request.seconds is not None and "steps" in request.world:
        raise UsageError(
            f"{option('seconds')} and {option('steps')} both state how long the recording is; give one",
            id="conflicting-options",
        )


def _walkers(scene: Scene, request: SceneRequest) -> WorldConfig:
    """Settings of randomly walking objects, from the request and the defaults for the scene's unit.

    With video, they keep at least half a diameter from walls unless the user sets `wall_clearance`.
    """
    defaults = WorldConfig.in_unit(scene.length_unit)
    world = configure(defaults, {**_times(defaults, request.rate_hz, request.seconds), **request.world})
    if request.render and "wall_clearance" not in request.world:
        world = replace(world, wall_clearance=max(world.wall_clearance, 0.5 * world.diameter))
    return world


def _scripted(scene: Scene, request: SceneRequest, script: MotionScript) -> WorldConfig:
    """Settings of time steps and objects for scripted paths.

    Args:
        scene: gives the unit of length.
        request: options, which override the paths file.
        script: contents of the paths file, which override the defaults.

    Raises:
        InputError: scene and paths have different units, or the frame rate of the paths file is not allowed.
    """
    if script.length_unit not in (None, scene.length_unit):
        raise InputError(
            f"{option('paths')}: its length unit is {script.length_unit}, the scene's {scene.length_unit}; use "
            "one unit",
            id="unit-mismatch",
        )
    defaults = replace(WorldConfig.in_unit(scene.length_unit), object_height=None)
    rate_hz = script.rate_hz if request.rate_hz is None else request.rate_hz
    seconds = script.seconds if request.seconds is None else request.seconds
    roles = [t.role for t in script.targets]
    numbers = {"targets": roles.count("target"), "occluders": roles.count("occluder")}
    try:
        return configure(defaults, {**numbers, **_times(defaults, rate_hz, seconds), **request.world})
    except SettingError as error:
        if error.setting == "step_s" and request.rate_hz is None:
            raise InputError(f"{request.paths}: rate_hz is {rate_hz:g}; {error}") from error
        raise


def _times(defaults: WorldConfig, rate_hz: float | None, seconds: float | None) -> dict[str, object]:
    """Duration of a step [s] (`step_s`), and the number of steps (`steps`) if a duration is stated.

    Args:
        defaults: gives the duration of a step if there is no rate.
        rate_hz: steps per second; None: not stated.
        seconds: duration of the recording; None: not stated.
    """
    step_s = defaults.step_s if rate_hz is None else 1.0 / rate_hz
    steps = {} if seconds is None else {"steps": round(seconds / step_s) + 1}
    return {"step_s": step_s, **steps}


def people_setup(request: SimulatePeopleRequest) -> Setup:
    """Settings of the video of people of equal appearance; 25 frames/s unless `fps` is set.

    UsageError for a number of occluders.
    """
    if "occluders" in request.world:
        raise UsageError(
            f"{option('occluders')}: all people of this scene are targets; leave it out", id="not-applicable"
        )
    size = {} if request.size is None else dict(zip(("width", "height"), request.size, strict=True))
    people = configure(PeopleConfig(), {**request.people, **size})
    rate_hz = request.fps or 25.0
    room = people_room(people.views, (people.width, people.height), rate_hz)
    asked = SceneRequest(
        output=request.output,
        world={"targets": people.people, "steps": people.frames, "wall_clearance": CLEARANCE, **request.world},
        rate_hz=rate_hz,
        render=True,
        rendering={**request.rendering, "identical_targets": True, "min_visibility": 0.0},
        store=request.store,
        workers=request.workers,
    )
    return replace(make_setup(room, asked), separate=people.start_separated)


def write_recording(
    setup: Setup, made: Provenance, output: Path, *, overwrite: bool = False, quiet: bool = False
) -> dict[str, object]:
    """Simulate and write a recording; return the summary of its contents.

    Args:
        setup: all settings.
        made: provenance, with the seed.
        output: file of the recording; videos are next to it.
        overwrite: replace existing files.
        quiet: show no progress bar.
    """
    seed = made.seed or 0
    start = _places_apart(setup, seed) if setup.separate else None
    if setup.render is not None and setup.script is not None:
        for chunk in _truth(setup, seed, start):
            check_inside(setup.scene, truth_grid(chunk), setup.world.start_ns)
    counts: Counter[str] = Counter()
    with (
        OutputGroup() as together,
        RecordingWriter(output, setup.scene, made, overwrite=overwrite, together=together) as writer,
    ):
        if setup.render is not None:
            appearances = reference_appearances(
                setup.scene, _targets(setup), setup.render, seed, colours=not setup.store.grey
            )
            writer.attach(APPEARANCE, "application/json", json.dumps(appearances).encode())
        chunks = _recorded(writer, setup, seed, start, counts)
        if setup.render is None:
            deque(console.progress(chunks, "simulate", quiet=quiet), maxlen=0)
        else:
            film(writer, setup, output, chunks, seed, counts, overwrite=overwrite, quiet=quiet)
    return _summary(setup, output, seed, counts)


def parameters(setup: Setup) -> dict[str, object]:
    """Return every parameter that influences the result, for the provenance."""
    world = asdict(setup.world)
    if world["motion"] == "waypoints":
        del world["motion"]
    if setup.script is not None:
        world = {k: world[k] for k in ("steps", "step_s", "diameter", "object_height", "start_ns")}
    observe = None if setup.observe is None else asdict(setup.observe)
    values: dict[str, object] = {"world": world, "observe": observe, "render": None}
    if setup.render is not None:
        values["render"] = {k: v for k, v in asdict(setup.render).items() if k != "workers"}
        values |= {"store": setup.store.store, "grey": setup.store.grey, "start_separated": setup.separate}
    if setup.field is not None:
        values["field"] = asdict(setup.field)
    if setup.sound != SoundConfig(step_s=setup.sound.step_s, known_heights=setup.sound.known_heights):
        values["sound"] = asdict(setup.sound)
    if setup.scene.readers or "strength" in setup.measure.kinds:
        values["reads"] = asdict(setup.reads)
    if setup.measure.kinds:
        values["measure"] = asdict(setup.measure)
    values["rates_hz"] = {c.name: c.rate_hz for c in setup.scene.cameras}
    return values


def _targets(setup: Setup) -> list[int]:
    """Numbers of the targets: rising from 0 for random walkers, those of the script in its order otherwise."""
    if setup.script is None:
        return list(range(setup.world.targets))
    return [t.id for t in setup.script.targets if t.role == "target"]


def _places_apart(setup: Setup, seed: int) -> Floats:
    """Start positions (n, 2) of people at which they do not occlude each other; UsageError if none are found."""
    try:
        return people_apart(setup.scene, setup.world.targets, seed)
    except InputError as error:
        raise UsageError(f"{error} ({option('overlapping')})") from error


def _truth(setup: Setup, seed: int, start: Floats | None) -> Iterator[Truth | TimeGrid]:
    """Generate chunks of the true paths: random walks or scripted paths.

    `start` (n, 2) are the first positions of the walks; None: random.
    """
    world, script = setup.world, setup.script
    if script is None:
        return simulate_truth(setup.scene, world, seed, start, field=setup.field, people=setup.people)
    z = math.nan if world.object_height is None else world.object_height
    return simulate_paths(script, steps=world.steps, step_s=world.step_s, z=z, start_ns=world.start_ns, seed=seed)


def _recorded(
    writer: RecordingWriter, setup: Setup, seed: int, start: Floats | None, counts: Counter[str]
) -> Iterator[Truth | TimeGrid]:
    """Generate the chunks of the truth; each is written before, with the simulated measurements, to the recording.

    Args:
        writer: writer of the recording.
        setup: scene and settings.
        seed: seed of the random numbers.
        start: (n, 2) first positions of random walks; None: random.
        counts: numbers of rows for the summary, updated in place.
    """
    truth, seen, heard, read, ranged = itertools.tee(_truth(setup, seed, start), 5)
    bearings = observe(setup.scene, seen, setup.observe or ObserveConfig(), seed)
    silent = silences(setup.script, setup.world.start_ns) if setup.script is not None else {}
    sounds = observe_arrays(
        setup.scene, heard, setup.observe or ObserveConfig(), seed, sound=setup.sound, silent=silent
    )
    reads = observe_readers(setup.scene, read, setup.reads, seed)
    distances = observe_stations(setup.scene, ranged, setup.measure, setup.reads, seed)
    others: tuple[tuple[bool, Iterator[ColumnTable], Iterator[Truth | TimeGrid], str], ...] = (
        (bool(setup.scene.arrays), sounds, heard, "doa"),
        (bool(setup.scene.readers), reads, read, "reads"),
        (bool(setup.measure.kinds), distances, ranged, "measurements"),
    )
    for chunk in truth:
        if setup.people is not None:
            counts["collisions"] += _contacts(truth_grid(chunk), setup.people, setup.world)
        writer.table(grid_truth(chunk) if isinstance(chunk, TimeGrid) else chunk)
        if setup.observe is not None:
            rows = next(bearings)
            writer.table(rows)
            counts.update(bearings=len(rows), seen=int(rows.seen.sum()))
        else:
            next(seen)
        for wanted, tables, paths, kind in others:
            if wanted:
                table = next(tables)
                writer.table(table)
                counts[kind] += len(table)
            else:
                next(paths)
        yield chunk


def _contacts(chunk: TimeGrid, people: MovingObstacleTracks, world: WorldConfig) -> int:
    """Count the time steps, summed over walkers, at which a person is closer to a walker than one diameter.

    Args:
        chunk: positions of the walkers at some time steps.
        people: recorded people whom the walkers avoid.
        world: diameter, and start and duration of the time steps.
    """
    numbers = np.rint((chunk.t_ns - world.start_ns) * 1e-9 / world.step_s).astype(np.int64)
    gaps = [
        distance(positions[:, None, :2], people.at(int(number)).xy)
        for number, positions in zip(numbers, chunk.xyz, strict=True)
    ]
    return sum(int(np.count_nonzero((gap < world.diameter).any(axis=1))) for gap in gaps)


def _summary(setup: Setup, output: Path, seed: int, counts: Counter[str]) -> dict[str, object]:
    world = setup.world
    summary: dict[str, object] = {
        "recording": str(output),
        "seed": seed,
        "steps": world.steps,
        "seconds": (world.steps - 1) * world.step_s,
        "targets": world.targets,
        "occluders": world.occluders,
        "cameras": len(setup.scene.cameras),
    }
    if setup.people is not None:
        summary |= {"people_avoided": len(setup.people.ids), "collisions": counts["collisions"]}
    if setup.observe is not None:
        summary |= {"bearings": counts["bearings"], "seen": counts["seen"]}
    if setup.scene.arrays:
        summary["doa"] = counts["doa"]
    if setup.scene.readers:
        summary["reads"] = counts["reads"]
    if setup.measure.kinds:
        summary["measurements"] = counts["measurements"]
    if setup.render is not None:
        summary |= {n: counts[n] for n in ("frames", "boxes", "video_bytes")}
    return summary
