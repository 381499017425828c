"""Run configurations, and the requests of their stages from the keys.

The keys of a stage are the long options of its command, with underscores for dashes.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from occlog.cli.main import COMMANDS
from occlog.errors import SPELLING, InputError, NoSceneError, UsageError, did_you_mean, option
from occlog.io.files.limits import STANDARD_INPUT
from occlog.io.files.texts.yaml import lines_of, read_yaml
from occlog.io.recording.reader import McapRecording, open_recording
from occlog.measure.detect.request import METHODS as DETECTIONS
from occlog.records.tables import (
    Bearings,
    Boxes,
    Doa,
    Measurements,
    Particles,
    Positions,
    Reads,
    Truth,
    TruthBoxes,
)
from occlog.request import Form, Request, Verb, Verbs, load
from occlog.simulate.request import KINDS
from occlog.track.catalogue import BOXES, IMAGES, METHODS, READS, UNCALIBRATED, VERB, VIEW
from occlog.track.catalogue import form_of as form_of_method

from .stage import READS as READER
from .stage import SET, STRICT, RunStage

SOURCES = ("recording", "simulate", "ingest", "table", "listen")
IN_IMAGES = (IMAGES, UNCALIBRATED)
"""What methods take in that track in the image of each camera."""
SEEN = {"bags", "video", "images", "boxes", "mot", "positions"}
"""Keys of `ingest` with inputs in which people are seen: images, boxes, positions."""
OVERLAY = "overlay"
"""Stage that draws tracks over the video: of all people unless it is false, of a target where it is there."""
STAGES = ("detect", "priors", "track", "evaluate", "report", OVERLAY)
PARTICLES = "particle_cloud"
"""Key of `track` that is true where the folder is to have the table `particles`."""
PRIORS = ("hull", "kalman", "acoustic")
KEYS = ("occlog_run", *SOURCES, *STAGES, "seed", "scene")
VALID = "valid keys:"


@dataclass(frozen=True)
class Config:
    """A run configuration.

    `path`: its file; `values`: content by key; `lines`: line of each value in the file, by path of keys such as
    `$.track.method`.
    """

    path: Path
    values: dict[str, object]
    lines: Mapping[str, int] = field(default_factory=dict)

    def at(self, *keys: str) -> str:
        """Return the name of a key for messages, with file and line: `run.yaml: line 5: track.particles`.

        `keys`: path to it.
        """
        for length in range(len(keys), 0, -1):
            line = self.lines.get(".".join(("$", *keys[:length])))
            if line is not None:
                return f"{self.path}: line {line}: {'.'.join(keys)}"
        return f"{self.path}: {'.'.join(keys)}"

    def stage(self, name: str) -> dict[str, object]:
        """Return the keys and values of a stage; empty if the configuration does not have it."""
        values = self.values.get(name)
        return dict(values) if isinstance(values, dict) else {}


def read_config(path: Path, sources: tuple[str, ...] = SOURCES) -> Config:
    """Read a configuration (YAML); InputError with an unknown key and the most similar valid one.

    Args:
        path: the file.
        sources: keys of which it must have exactly one; empty: it must have no source of recordings.
    """
    values = read_yaml(path, dict, "a run configuration (YAML)")
    for key in values:
        if key not in KEYS:
            raise InputError(f"{path}: unknown key {key!r}; {did_you_mean(str(key), KEYS, VALID)}", id="unknown-key")
    if values.get("occlog_run") != 1:
        raise InputError(
            f"{path}: expected `occlog_run: 1` (the version of this format), got {values.get('occlog_run')!r}",
            id="version-mismatch",
        )
    given = [s for s in SOURCES if s in values]
    if given and not sources:
        raise InputError(
            f"{path}: {given[0]}: a batch has its recordings from the command line; remove this key",
            id="not-applicable",
        )
    if sources and len(given) != 1:
        raise InputError(
            f"{path}: give exactly one of {', '.join(sources)}; got {', '.join(given) or 'none'}",
            id="conflicting-options",
        )
    for name in ("simulate", "ingest", "listen", *STAGES):
        if not isinstance(values.get(name) or {}, dict):
            raise InputError(f"{path}: {name}: expected keys and values, got {values[name]!r}")
    return Config(path, values, lines_of(path))


def check_settings(config: Config, stage: RunStage) -> None:
    """Check the values of a stage before any stage runs; InputError with the line of the file."""
    if STANDARD_INPUT not in stage.texts():  # it can be read once
        with refused_in(config, stage.name):
            stage.check()


@contextmanager
def refused_in(config: Config, stage: str) -> Iterator[None]:
    """Context manager that converts errors of a stage to InputError with the line of the value in the configuration."""
    spelling = SPELLING.set(str)
    try:
        yield
    except NoSceneError as error:
        where = _place(config, stage, ("scene",)) if "scene" in config.stage(stage) else config.at("scene")
        raise InputError(
            f"{where}: {error.where} holds no scene; name here a scene file or a recording with one", id="missing-scene"
        ) from error
    except UsageError as error:
        if not error.options:
            raise
        named = tuple(error.options[0].split("."))
        problem = str(error).removeprefix(error.options[0]).lstrip(": ")
        raise InputError(f"{_place(config, stage, named)}: {problem}") from error
    except InputError as error:
        if not error.options and error.id != "file-not-found":  # the configuration names this file, in its own folder
            raise
        raise InputError(f"{config.at(stage)}: {error}") from error
    finally:
        SPELLING.reset(spelling)


def _place(config: Config, stage: str, keys: tuple[str, ...]) -> str:
    """Return the name of a key for messages: of the stage, or at top level if only that is given.

    `keys`: path to it.
    """
    whole = keys[0] in config.values and keys[0] not in config.stage(stage)
    return config.at(*keys) if whole else config.at(stage, *keys)


def plan(config: Config, folder: Path) -> Iterator[RunStage]:
    """Generate the stages of a configuration in order, with outputs in the run folder.

    Which stages follow depends on the content of the recording, so that a stage must have run before the iteration
    continues; without a recording the configuration determines its content.
    """
    method = str(config.stage("track").get("method"))
    if method in METHODS and METHODS[method].takes_in == VIEW:
        raise InputError(
            f"{config.path}: track: method {method} gives boxes with identities, of which no stage makes a "
            "report; call `occlog track` with boxes or views",
            id="not-applicable",
        )
    recording = folder / "recording.mcap"
    out = {n: folder / f"{n}.parquet" for n in ("bearings", "views", "tracks", "diagnostics", "errors", "bound")}
    if "table" in config.values or "listen" in config.values:
        yield from _of_table(config, folder, out)
        return
    if "simulate" in config.values or "ingest" in config.values:
        name = "simulate" if "simulate" in config.values else "ingest"
        yield _stage(config, name, {"output": recording}, ())
    else:
        recording = config.path.resolve().parent / str(config.values["recording"])
    scene = {"scene": config.values.get("scene", str(recording))}
    of_tags = method in METHODS and METHODS[method].takes_in == READS
    if of_tags or not _has_views(config, recording):
        yield from _without_views(config, folder, recording, out, scene)
        return
    detected = {"output": out["bearings"], "views": out["views"]}
    how = config.stage("detect")
    if "onnx" in how or how.get("method", DETECTIONS[0]) not in DETECTIONS:
        # Of a network or a plug-in the boxes are the first output
        detected = {"output": out["views"], "bearings": out["bearings"]}
    given = {"scene": config.values["scene"]} if "scene" in config.values else None
    if method in METHODS and METHODS[method].takes_in in IN_IMAGES:
        if not _has_video(config, recording):
            yield from _in_images(config, folder, recording, recording, METHODS[method].takes_in)
            return
        yield _stage(config, "detect", detected, (str(recording),), given)
        yield from _in_images(config, folder, recording, out["views"], METHODS[method].takes_in)
        return
    if _of_all_targets(config) and _has_positions(config, recording):
        # Boxes and positions of the recording are tracked as they are
        yield from _all_people(config, folder, recording, {**out, "views": recording}, scene)
        return
    yield _stage(config, "detect", detected, (str(recording),), given)
    if _of_all_targets(config):
        yield from _all_people(config, folder, recording, out, scene)
        return
    config, tracked = _with_particles(config, folder, {"output": out["tracks"], "diagnostics": out["diagnostics"]})
    inputs = dict(scene)
    if "priors" in config.values:
        stage, found = _priors(config, folder, recording, out, scene)
        yield stage
        inputs["occluders"] = found
    yield _stage(config, "track", tracked, (str(out["bearings"]),), inputs)
    metrics = folder / "metrics.json"
    results = {"output": metrics, "errors": out["errors"], "bound": out["bound"]}
    truth = _truth(config, recording, out["views"])
    compared: dict[str, object] = {
        **scene,
        "bearings": str(out["bearings"]),
        "diagnostics": str(out["diagnostics"]),
        **truth,
    }
    yield _stage(config, "evaluate", results, (str(out["tracks"]),), compared)
    shown = {k: v for k, v in {**truth, **inputs}.items() if k in ("truth", "occluders", "scene")}
    config, pictures = _images(config, recording)
    tables = {name: str(out[name]) for name in ("bearings", "diagnostics", "errors", "bound")}
    yield _report(config, folder, out["tracks"], {**shown, **pictures, **tables, "metrics": str(metrics)})
    if OVERLAY in config.values:
        yield from _overlay(config, folder, recording, out["tracks"], {**scene, "diagnostics": str(out["diagnostics"])})


def _of_table(config: Config, folder: Path, out: dict[str, Path]) -> Iterator[RunStage]:
    """Generate the stages for measurements in a table, or for sound, neither of which needs detection.

    Without a scene the positions of arrays are unknown: directions are the result. `out`: paths of tables by name.
    """
    if "table" in config.values:
        measured = config.path.resolve().parent / str(config.values["table"])
        if "scene" not in config.values:
            raise InputError(
                f"{config.at('table')}: a file of measurements holds no scene; add the key `scene` with a scene "
                "file or a table of sensor positions",
                id="missing-scene",
            )
    else:
        measured = folder / "doa.parquet"
        given = {"scene": config.values["scene"]} if "scene" in config.values else None
        yield _stage(config, "listen", {"output": measured}, (), given)
    scene = {"scene": config.values["scene"]} if "scene" in config.values else {}
    if not scene:
        if "truth_azimuths" in config.stage("evaluate"):
            yield _stage(config, "evaluate", {"output": folder / "metrics.json"}, (), {"doa": str(measured)})
    elif _of_all_targets(config):
        yield from _all_people(config, folder, measured, {**out, "views": measured}, scene)
    else:
        yield from _without_views(config, folder, measured, out, scene)


def _without_views(
    config: Config, folder: Path, measured: Path, out: dict[str, Path], scene: dict[str, object]
) -> Iterator[RunStage]:
    """Generate the stages for measurements without images and boxes: bearings, directions, ranges, tag reads.

    Args:
        config: the configuration.
        folder: folder of the run.
        measured: the recording, or the table of measurements.
        out: paths of the outputs by name.
        scene: input `scene`, or empty.
    """
    if config.values.get("detect"):
        raise InputError(
            f"{config.at('detect')}: there are no images and no boxes to detect in; remove this key",
            id="not-applicable",
        )
    method = str(config.stage("track").get("method", VERB.default))
    known = [entry.key for entry in form_of_method(method).entries()]
    config, tracked = _with_particles(config, folder, {"output": out["tracks"]})
    tracked |= {"diagnostics": out["diagnostics"]} if "diagnostics" in known else {}
    yield _stage(config, "track", tracked, (str(measured),), scene)
    diagnosed = {"diagnostics": str(out["diagnostics"])} if "diagnostics" in known else {}
    recording = measured if "table" not in config.values and "listen" not in config.values else None
    truth = {} if recording is None and "truth" not in config.stage("evaluate") else _truth(config, measured, measured)
    shown = {key: value for key, value in {**truth, **scene}.items() if key in ("truth", "scene")}
    if truth:
        results = {"output": folder / "metrics.json", "errors": out["errors"]}
        yield _stage(config, "evaluate", results, (str(out["tracks"]),), {**shown, **diagnosed})
        shown |= {"errors": str(out["errors"]), "metrics": str(folder / "metrics.json")}
    yield _report(config, folder, out["tracks"], {**shown, **diagnosed})


def _has_views(config: Config, recording: Path) -> bool:
    """Return whether a recording holds images, boxes or bearings; if it does not exist yet, by the configuration."""
    if recording.is_file():
        try:
            opened = open_recording(recording)
        except InputError:  # the next stage reports it
            return True
        return bool(opened.cameras) or any(map(opened.has, (Boxes, Bearings, Positions))) or not _measures(opened)
    return "ingest" not in config.values or bool(config.stage("ingest").keys() & SEEN)


def _measures(recording: McapRecording) -> bool:
    """Return whether a recording holds measurements other than those of cameras: directions, tag reads, ranges."""
    return any(recording.has(table) for table in (Doa, Reads, Measurements))


def _with_particles(config: Config, folder: Path, tracked: dict[str, Path]) -> tuple[Config, dict[str, Path]]:
    """Return the configuration without the key for particles, and the outputs of `track`, with particles if true.

    `tracked`: outputs of `track` so far (not changed). InputError for a value that is neither true nor false.
    """
    values = config.stage("track")
    asked = values.pop(PARTICLES, False)
    if not isinstance(asked, bool):
        raise InputError(
            f"{config.at('track', PARTICLES)}: expected true or false (outputs of a run are in its folder)",
            id="not-applicable",
        )
    if asked:
        tracked = {**tracked, PARTICLES: folder / f"{Particles.NAME}.parquet"}
    return replace(config, values={**config.values, "track": values}), tracked


def _overlay(
    config: Config, folder: Path, recording: Path, tracks: Path, inputs: dict[str, object]
) -> Iterator[RunStage]:
    """Generate the stage that draws tracks over the video of the recording; none if disabled, or without video.

    InputError if it is configured, but there is no video.

    Args:
        config: configuration of the run.
        folder: folder of the run.
        recording: with the video.
        tracks: table of tracks.
        inputs: further inputs by key.
    """
    if config.values.get(OVERLAY) is False:
        return
    if _has_video(config, recording):
        drawn: dict[str, Path] = {"video": folder / "overlay.webm"}
        source: dict[str, object] = {"recording": str(recording), **inputs}
        yield _stage(config, OVERLAY, drawn, (str(tracks),), source, "report")
    elif OVERLAY in config.values:
        raise InputError(f"{config.path}: overlay: the recording holds no video; remove this key", id="not-applicable")


def _of_all_targets(config: Config) -> bool:
    """Return whether the method tracks all people from boxes, rather than targets from bearings."""
    method = str(config.stage("track").get("method"))
    if method not in METHODS or METHODS[method].takes_in != BOXES:
        return False
    if "priors" in config.values:
        raise InputError(f"{config.path}: priors: method {method} takes none; remove this key", id="not-applicable")
    return True


def _all_people(
    config: Config, folder: Path, recording: Path, out: dict[str, Path], scene: dict[str, object]
) -> Iterator[RunStage]:
    """Generate the stages after detection for methods that track all people on the ground and in the images.

    Args:
        config: configuration of the run.
        folder: folder of the run.
        recording: the recording.
        out: paths of tables by name.
        scene: input `scene`, or empty.
    """
    found = {n: folder / f"{n}.parquet" for n in ("associations", "events", "view_tracks")}
    yield _stage(config, "track", {"output": out["tracks"], **found}, (str(out["views"]),), scene)
    inputs, shown, metrics = dict(scene), dict(scene), folder / "metrics.json"
    truth = _truth(config, recording, out["views"])
    in_images = {"output": folder / "metrics_in_images.json"}
    compared: dict[str, object] = {"truth": truth.get("truth")}
    if "views" in truth and recording.is_file() and not _held(recording)[0]:
        # A truth of boxes alone has no positions to compare tracks on the ground with
        yield _stage(config, "evaluate", in_images, (str(found["view_tracks"]),), compared)
        shown["metrics"] = str(in_images["output"])
    elif truth:
        inputs["truth"] = shown["truth"] = truth["truth"]
        results = {"output": metrics, "errors": out["errors"]}
        yield _stage(config, "evaluate", results, (str(out["tracks"]),), inputs)
        shown |= {"errors": str(out["errors"]), "metrics": str(metrics)}
        if "views" in truth:
            plain = replace(config, values={k: v for k, v in config.values.items() if k != "evaluate"})
            stage = _stage(plain, "evaluate", in_images, (str(found["view_tracks"]),), compared)
            yield replace(stage, name="evaluate-in-images")
    config, pictures = _images(config, recording)
    seen = {} if out["views"] == recording or "table" in config.values else {"bearings": str(out["bearings"])}
    given = {**shown, **pictures, **seen, "events": str(found["events"])}
    yield _report(config, folder, out["tracks"], given)
    yield from _overlay(config, folder, recording, found["view_tracks"], {**scene, "ground_tracks": str(out["tracks"])})


def _in_images(config: Config, folder: Path, recording: Path, boxes: Path, takes_in: str) -> Iterator[RunStage]:
    """Generate the stages after detection for methods that track targets in the image of each camera.

    Args:
        config: the configuration.
        folder: folder of the run.
        recording: with images, boxes or both.
        boxes: views of the stage `detect`, or the recording.
        takes_in: kind of input of the method.
    """
    method = str(config.stage("track").get("method"))
    known = [entry.key for entry in form_of_method(method).entries()]
    tracks = folder / "view_tracks.parquet"
    tracked = {"output": tracks, **({"events": folder / "events.parquet"} if "events" in known else {})}
    with_boxes: dict[str, object] = {"detections": str(boxes)}
    source = recording if takes_in == IMAGES else boxes
    yield _stage(config, "track", tracked, (str(source),), {} if source == boxes else with_boxes)
    shown: dict[str, object] = {name: str(path) for name, path in tracked.items() if name == "events"}
    truth = _truth(config, recording, boxes)
    if "views" in truth or "truth" in config.stage("evaluate"):
        results = {"output": folder / "metrics.json"}
        yield _stage(config, "evaluate", results, (str(tracks),), {"truth": truth["truth"]})
        shown["metrics"] = str(results["output"])
    config, pictures = _images(config, recording)
    yield _report(config, folder, tracks, {**shown, **pictures})
    yield from _overlay(config, folder, recording, tracks, {})


def _has_positions(config: Config, recording: Path) -> bool:
    """Return whether the recording holds positions on the ground; if it does not exist yet, by the configuration.

    Raises:
        InputError: it also holds images, in which people would have to be detected first.
    """
    found = open_recording(recording).has(Positions) if recording.is_file() else "positions" in config.stage("ingest")
    if found and _has_video(config, recording):
        raise InputError(
            f"{config.path}: the recording holds positions and images; detect people in the images first, and ingest "
            "their boxes with the positions",
            id="wrong-content",
        )
    return found


def _has_video(config: Config, recording: Path) -> bool:
    """Return whether the recording holds images; if it does not exist yet, by the configuration."""
    if recording.is_file():
        return bool(open_recording(recording).cameras)
    simulated, ingested = config.stage("simulate"), config.stage("ingest")
    return bool(simulated.get("render") or simulated.get("scene") in KINDS or ingested.keys() & {"video", "images"})


def _priors(
    config: Config, folder: Path, recording: Path, out: dict[str, Path], scene: dict[str, object]
) -> tuple[RunStage, str]:
    """Return the stage that estimates priors of moving occluders, and the path of its result for `track`.

    The result is the table of hulls, if this source of priors makes one, else that of Gaussian priors. InputError for
    an unknown source.

    Args:
        config: configuration of the run.
        folder: folder of the run.
        recording: the recording.
        out: paths of tables by name.
        scene: input `scene`, or empty.
    """
    values = config.stage("priors")
    kind = values.get("source", "hull")
    if kind not in PRIORS:
        raise InputError(
            f"{config.path}: priors.source: {kind!r}; {did_you_mean(str(kind), PRIORS, 'kinds:')}", id="unknown-name"
        )
    outputs = {"output": folder / "occluders.parquet"}
    if kind == "hull":
        outputs["hulls"] = folder / "hulls.parquet"
        inputs, source = {**scene, "bearings": str(out["bearings"])}, str(out["views"])
    else:
        inputs, source = scene, str(recording)
    own = replace(config, values={**config.values, "priors": {k: v for k, v in values.items() if k != "source"}})
    stage = _stage(own, "priors", outputs, (source,), inputs, f"priors {kind}")
    return stage, str(outputs.get("hulls", outputs["output"]))


def _truth(config: Config, recording: Path, views: Path) -> dict[str, str]:
    """Return the input `truth`, and `views` if there are true boxes, by key; empty without a truth.

    A file in the configuration has priority over the recording.

    Args:
        config: configuration of the run.
        recording: may hold true positions or boxes.
        views: table of views.
    """
    given = config.stage("evaluate").get("truth")
    if given is not None:
        return {"truth": str(given)}
    simulated = config.stage("simulate") if "simulate" in config.values else None
    if recording.is_file():
        with_truth, boxes = _held(recording)
    else:
        with_truth = simulated is not None or "truth" in config.stage("ingest")
        boxes = bool(simulated and (simulated.get("render") or simulated.get("scene") in KINDS))
    found = {"truth": str(recording)} if with_truth or boxes else {}
    return {**found, "views": str(views)} if boxes else found


def _held(recording: Path) -> tuple[bool, bool]:
    """Return whether a recording holds true positions, and whether it holds true boxes."""
    opened = open_recording(recording)
    return opened.has(Truth), opened.has(TruthBoxes)


def _images(config: Config, recording: Path) -> tuple[Config, dict[str, str]]:
    """Return the input `images` of the report if the recording has some, and the configuration.

    `report: {images: false}` disables it; that key is then removed from the configuration.
    """
    values = config.stage("report")
    if values.get("images") is False:
        del values["images"]
        return replace(config, values={**config.values, "report": values}), {}
    return config, {"images": str(recording)} if _has_video(config, recording) else {}


def _report(config: Config, folder: Path, tracks: Path, inputs: dict[str, object]) -> RunStage:
    page = {"output": folder / "report.html", "png": folder / "report.png", "markdown": folder / "report.md"}
    return _stage(config, "report", page, (str(tracks),), inputs)


def _stage(
    config: Config,
    name: str,
    outputs: dict[str, Path],
    arguments: tuple[str, ...],
    inputs: dict[str, object] | None = None,
    verb: str = "",
) -> RunStage:
    for key in outputs:
        if key in config.stage(name):
            raise InputError(
                f"{config.path}: {name}.{key}: outputs of a run are in its folder; remove this key", id="not-applicable"
            )
    verb, _, source = (verb or name).partition(" ")
    values = {**(inputs or {}), **config.stage(name), **outputs}
    with refused_in(config, name):
        declared = load(COMMANDS[verb].where)
        form = form_of(declared, source, values)
        names = tuple(str(path) for path in outputs.values())
        keys = [entry.key for entry in form.entries() if entry.file is not None and entry.file.argument]
        given = dict(zip(keys, arguments, strict=False))
        seed = {"seed": config.values["seed"]} if "seed" in config.values and _takes(form, "seed") else {}
        stage = RunStage(name, form, {**given, **seed, **values}, names)
        known = stage.keys()
    for key in stage.values:
        if key not in known:
            raise InputError(
                f"{config.at(name, key)}: unknown key; {_hint(stage, declared, key, known)}", id="unknown-key"
            )
    return stage


def _hint(stage: RunStage, verb: type[Request] | Verb | Verbs, key: str, known: Collection[str]) -> str:
    """Return the remedy for an unknown key of a stage: where it belongs, or the most similar key.

    Args:
        stage: the stage.
        verb: its requests.
        key: the unknown key.
        known: keys that the stage has.
    """
    if stage.without_key(key):
        return f"it is a setting; give it under set: `set: {{{key}: ...}}`"
    kinds = verb.kinds.items() if isinstance(verb, Verb) else ()
    owners = [name for name, kind in kinds if any(entry.key == key for entry in kind.form().entries())]
    if isinstance(verb, Verb) and owners:
        return f"it is a key of {verb.what} {', '.join(owners)}; remove it, or choose one of them"
    return did_you_mean(key, sorted(known), VALID)


def known_keys(stage: str, values: Mapping[str, object]) -> tuple[str, ...]:
    """Return the keys that a stage can have, over all kinds of its command that its `values` leave open.

    Empty for a plug-in, which has keys of its own.
    """
    verb = load(COMMANDS["report" if stage == OVERLAY else stage].where)
    by: tuple[str, ...] = ()
    if isinstance(verb, Verbs):
        forms = [Form(request) for request, _ in verb.verbs.values()]
    elif isinstance(verb, Verb):
        forms, by = [kind.form() for kind in verb.kinds.values()], tuple(verb.by)
        chosen = {choose(str(values[key])) for key, choose in verb.by.items() if values.get(key) is not None}
        if chosen - {*verb.kinds, ""}:
            return ()
    else:
        forms = [Form(verb)]
    plugged = {entry.key for form in forms for entry in form.entries() if entry.plugged is not None}
    if not plugged.isdisjoint(values) or READER in values:
        return ()
    keys = (entry.key for form in forms for entry in form.entries())
    return tuple(dict.fromkeys((*keys, *by, READER, SET, STRICT)))


def form_of(verb: type[Request] | Verb | Verbs, name: str, values: Mapping[str, object]) -> Form:
    """Return the form of a command's request, of the kind that the values of the configuration select.

    Args:
        verb: the request class or classes of the command.
        name: name of the subcommand, if there are several.
        values: by key.

    Raises:
        UsageError: there is no such kind; the message has the nearest.
    """
    if isinstance(verb, Verbs):
        return Form(verb.verbs[name][0])
    if isinstance(verb, type):
        return Form(verb)
    for key, choose in verb.by.items():
        kind = "" if values.get(key) is None else choose(str(values[key]))
        if kind:
            try:
                return verb.form(kind)
            except UsageError as error:
                raise UsageError(f"{option(key)}: {error}") from error
    return verb.form(verb.default)


def _takes(form: Form, key: str) -> bool:
    return any(entry.key == key for entry in form.entries())
