"""`occlog info`: description of a scene, recording, occlog or external table, bag, or folder."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from occlog import console
from occlog.cli import options
from occlog.console.summary import plausible_in_words
from occlog.console.text import counted
from occlog.errors import InputError
from occlog.io.files.timing.utc import time_words, utc
from occlog.io.recognition import FileContent, contents_of, is_one_bag, is_ros_bag
from occlog.records.losses import Loss

if TYPE_CHECKING:
    from occlog.io.external.names import Spelling
    from occlog.io.external.table import ExternalTable
    from occlog.io.recording.reader import McapRecording
    from occlog.records.scene import Camera, MicrophoneArray, Scene, TagReader


MAX_ENTRIES = 1000
"""Entries of a folder that are checked."""
Described = tuple[Mapping[str, object], list[str]]


def describe_folder(folder: Path, describe: Callable[[Path], Described]) -> Described:
    """Describe each file of a folder in one line; return values for JSON, and lines of text.

    Args:
        folder: its first `MAX_ENTRIES` entries are described; subfolders only if they are bags.
        describe: returns values and lines of one file; InputError if occlog cannot read it.

    Raises:
        InputError: the folder is empty, or cannot be listed.
    """
    try:
        entries = sorted(islice(folder.iterdir(), MAX_ENTRIES + 1))
    except OSError as error:
        raise InputError(f"{folder}: cannot be listed: {error.strerror or error}", id="unreadable-file") from error
    if not entries:
        raise InputError(f"{folder}: is an empty folder", id="empty-input")
    files: list[Mapping[str, object]] = []
    lines, others = [], Counter[str]()
    width = max(len(path.name) for path in entries[:MAX_ENTRIES])
    for path in entries[:MAX_ENTRIES]:
        try:
            if path.is_dir() and not is_one_bag(path):
                if not (kinds := _kinds(path)):
                    others["folder"] += 1
                    continue
                files.append({"file": path.name, "kind": kinds[0].kind.value, "format": kinds[0].words})
                lines.append(f"{path.name:<{width}}  {kinds[0].words}")
                continue
            values, described = describe(path)
        except InputError as error:
            if path.suffix.lower() not in (".mcap", ".parquet", ".db3", ".bag"):
                if not (kinds := _kinds(path)):
                    others[path.suffix.lower() or "without an ending"] += 1
                    continue
                files.append({"file": path.name, "kind": kinds[0].kind.value, "format": kinds[0].words})
                lines.append(f"{path.name:<{width}}  {kinds[0].words}")
                continue
            values, described = {"kind": "unreadable", "error": str(error)}, [f"cannot be read: {error}"]
        files.append({"file": path.name, **values})
        time = "".join(f", {line.removeprefix('time').strip()}" for line in described[1:2] if line.startswith("time"))
        lines.append(f"{path.name:<{width}}  {described[0]}{time}")
    head = f"folder, {counted(len(files), 'file')} that occlog reads"
    more = [f"{n} x {what}" for what, n in sorted(others.items())]
    more += [f"entries after the first {MAX_ENTRIES} were not checked"] if len(entries) > MAX_ENTRIES else []
    values = {
        "kind": "folder",
        "files": files,
        "others": dict(sorted(others.items())),
        "complete": len(entries) <= MAX_ENTRIES,
    }
    return values, [head, *lines, *([f"others: {', '.join(more)}"] if more else [])]


def _kinds(path: Path) -> list[FileContent]:
    """Return what a file may be for the readers of `occlog ingest`, best guess first; empty for a damaged file."""
    try:
        return contents_of(path)
    except InputError:
        return []


SHOWN_VERSIONS = ("python", "numpy", "scipy", "numba", "opencv-python-headless", "pyarrow")
"""Packages with versions that change figures most; `--json` has all."""
TABLES_OR_RECORDINGS = (".mcap", ".parquet", ".csv", ".tsv", ".gz", ".arrow", ".feather")
"""File name endings with a reader that describes faults of the content."""


@click.command(name="info", short_help="Describe a scene, recording, table or run folder.")
@click.argument("path", type=options.INPUT)
@click.option(
    "--rows", type=click.IntRange(min=0), default=5, show_default=True, help="Number of rows of a table to print."
)
@options.json_opt
def command(path: Path, rows: int, as_json: bool) -> None:
    """Describe PATH: a scene (YAML), a recording (MCAP), a bag of ROS or a table (Parquet, Arrow, CSV).

    For a folder that is no bag one line per readable file is printed.

    For an external table the meaning of each column is printed, for a bag (a folder, .mcap, .db3, .bag) its topics and
    what `occlog ingest` would read from it.

    \b
      occlog info run/recording.mcap
      occlog info tracks.parquet --rows 20
      occlog info scene.yaml --json | jq .cameras
      occlog info run/
    """
    described = describe(path, rows)
    if as_json:
        console.echo_summary(described.values, True)
    else:
        click.echo("\n".join(described.lines))


class Description(NamedTuple):
    """Description of a file, as plain values for JSON and as text lines."""

    values: Mapping[str, object]
    lines: list[str]


def describe(path: Path, rows: int) -> Description:
    """Describe a file or folder by its content.

    Of a table also the first `rows` rows. InputError for an unknown kind.
    """
    from occlog.io.files.limits import describe_unsupported
    from occlog.io.open import is_table_in_parts, open_if_ours, open_input

    kind = path.suffix.lower()
    if path.is_dir() and not is_one_bag(path) and not is_table_in_parts(path):
        return Description(*describe_folder(path, lambda file: describe(file, 0)))
    if is_ros_bag(path):
        return _describe_bag(path)
    opened = open_if_ours(path, "a scene (.yaml), a recording (.mcap) or a table (.parquet, .arrow, .csv)")
    if opened is None and kind in (".yaml", ".yml"):
        from occlog.io.formats.scenes.scene import read_scene

        return _describe_scene(read_scene(path))
    if opened is None and kind in TABLES_OR_RECORDINGS:
        opened = open_input(path)
    if opened is not None and opened.external_table is not None:
        return _describe_external(opened.external_table)
    if opened is not None:
        return _describe_table(path, rows) if opened.recording is None else _describe_recording(opened.recording)
    mistaken = describe_unsupported(path)
    if mistaken is not None:
        raise InputError(f"{path}: is {mistaken}", id="unknown-format")
    known = "scenes (.yaml), recordings (.mcap) and tables (.parquet, .arrow, .csv, .tum, .trc, .geojson)"
    raise InputError(
        f"{path}: occlog info knows {known}, not {kind or 'files without an ending'!r}", id="unknown-format"
    )


def _describe_bag(path: Path) -> Description:
    """Describe a ROS bag: topics, rates, what `occlog ingest` would read from it, and its command."""
    from occlog.errors import UsageError
    from occlog.io.messages.bag import borrowed_lines, open_bag, survey, topic_lines
    from occlog.io.messages.kinds import TopicKind, kind_of

    with open_bag([path]) as bag:
        topics, span = bag.topics(), bag.span()
        seconds = 0.0 if span is None else (span[1] - span[0]) / 1e9
        total = sum(t.messages or 0 for t in topics.values())
        lines = [f"bag of another program, {counted(len(bag.files), 'file')}, {counted(total, 'message')}"]
        lines += [] if span is None else [f"time      {utc(span[0])} to {utc(span[1])}, {seconds:.3f} s"]
        for t in topics.values():
            rate = f", {(t.messages - 1) / seconds:.3g} Hz" if t.messages and t.messages > 1 and seconds else ""
            lines.append(f"topic     {t.name}: {t.messages} x {t.kind or '(no type)'} ({t.encoding or '?'}){rate}")
        taken: list[str] = []
        remark, borrowed = "", list[str]()
        try:
            found = survey(bag, (), transforms_too=False)
            taken = [line for line in topic_lines(found) if not line.startswith("not taken")]
            borrowed = borrowed_lines(found)
        except (InputError, UsageError) as error:
            remark = str(error)
        remark = "; ".join(
            ([remark] if remark else []) + borrowed + [f"{topic}: {note}" for topic, note in bag.remarks.items()]
        )
        lines += [f"taken     {line}" for line in taken] + ([f"note      {remark}"] if remark else [])
        if taken or any(kind_of(t.kind) for t in topics.values()):
            lines.append(f"command   occlog ingest {path} -o recording.mcap")
        names = {TopicKind.BOX: "CAMERA", TopicKind.POSE: "0", TopicKind.DIRECTION: "ARRAY"}
        more = [(t.name, names[k]) for t in topics.values() if (k := kind_of(t.kind)) in names]
        lines += [f"more      --topic {name}={topic}" for topic, name in more]
        lines += [f"lost      {loss}" for loss in bag.losses]
        values = {
            "kind": "bag",
            "files": [file.name for file in bag.files],
            "topics": [
                {"topic": t.name, "schema": t.kind, "encoding": t.encoding, "messages": t.messages}
                for t in topics.values()
            ],
            "time_ns": span,
            "used": taken,
            "note": remark or None,
            "lost": [loss.as_dict() for loss in bag.losses],
        }
    return Description(values, lines)


def _describe_scene(scene: Scene) -> Description:
    cameras = [_camera(c) for c in scene.cameras]
    unit = scene.length_unit
    lines = [f"scene, lengths in {unit}"]
    if scene.room is not None:
        low, high = scene.room.min(axis=0), scene.room.max(axis=0)
        lines.append(
            f"room      {len(scene.room)} corners, {high[0] - low[0]:g} x {high[1] - low[1]:g} {unit}, "
            f"from ({low[0]:g}, {low[1]:g}) to ({high[0]:g}, {high[1]:g})"
        )
    lines += [f"occluder  {o.name}: {len(o.polygon)} corners, height {o.height:g} {unit}" for o in scene.occluders]
    lines += [f"camera    {line}" for line in _camera_lines(scene)]
    lines += [
        f"array     {a.name}: at ({a.position[0]:g}, {a.position[1]:g}, {a.position[2]:g}), "
        f"{len(a.microphones)} microphones, sigma {math.degrees(a.sigma):.3g} deg{_array_more(a)}"
        for a in scene.arrays
    ]
    lines += [f"reader    {_reader_words(r)}" for r in scene.readers]
    lines += [f"clock     {c.name}: offset {c.offset_ns / 1e9:.9g} s, drift {c.drift_ppm:g} ppm" for c in scene.clocks]
    values = {
        "kind": "scene",
        "length_unit": unit,
        "room": None if scene.room is None else scene.room.tolist(),
        "occluders": [o.name for o in scene.occluders],
        "cameras": cameras,
        "arrays": [a.name for a in scene.arrays],
        **({"readers": [r.name for r in scene.readers]} if scene.readers else {}),
        "clocks": [c.name for c in scene.clocks],
    }
    return Description(values, lines)


def _camera(c: Camera) -> dict[str, object]:
    yaw, pitch, roll = _angles(c)
    return {
        "name": c.name,
        "placed": c.placed,
        "position": c.position.tolist(),
        "yaw_deg": yaw,
        "pitch_deg": pitch,
        "roll_deg": roll,
        "focal_px": c.focal_px.tolist(),
        "image_size_px": c.image_size,
        "fov_deg": math.degrees(c.fov),
        "noise": {"position": c.sigma_position, "yaw": c.sigma_yaw, "measurement_noise_px": c.sigma_read_px},
    }


def _angles(c: Camera) -> tuple[float, float, float]:
    """Return yaw, pitch and roll of a camera [deg]."""
    from occlog.core.geometry.camera import angles_from_rotation

    yaw, pitch, roll = (math.degrees(a) for a in angles_from_rotation(c.rotation))
    return yaw, pitch, roll


def _array_more(array: MicrophoneArray) -> str:
    """Return the properties of an array that differ from the default, as text."""
    parts = []
    if not array.upright:
        parts.append(f"pitch {math.degrees(array.pitch):.3g} deg, roll {math.degrees(array.roll):.3g} deg")
    if math.isfinite(array.range):
        parts.append(f"range {array.range:g}")
    if array.resolution > 0:
        parts.append(f"resolution {math.degrees(array.resolution):.3g} deg")
    if array.planar:
        parts.append("no elevation")
    return "".join(f", {part}" for part in parts)


def _reader_words(reader: TagReader) -> str:
    """Return a reader's position, with range and power if known, as text."""
    far = f", range {reader.range:g}" if math.isfinite(reader.range) else ""
    power = "" if reader.power is None else f", {reader.power:g} dBm at 1 m"
    x, y, z = reader.position
    return f"{reader.name}: at ({x:g}, {y:g}, {z:g}){far}{power}"


def _camera_lines(scene: Scene) -> Iterator[str]:
    for c in scene.cameras:
        yaw, pitch, roll = _angles(c)
        size = "x".join(str(n) for n in c.image_size) + " px, " if c.image_size else ""
        if not c.placed:
            yield f"{c.name}: {size}no pose: gives no bearings"
            continue
        x, y, z = c.position
        tilt = f", pitch {pitch:.1f}, roll {roll:.1f}" if abs(pitch) + abs(roll) > 0.05 else ""
        yield (
            f"{c.name}: {size}at ({x:.3g}, {y:.3g}, {z:.3g}), yaw {yaw:.1f}{tilt} deg, "
            f"f {c.focal_px[0]:.5g} px, fov {math.degrees(c.fov):.1f} deg"
        )


def _describe_recording(recording: McapRecording) -> Description:
    topics = [{"topic": t.name, "schema": t.schema, "messages": t.messages} for t in recording.topics]
    span = recording.time_ns
    lines = [f"recording, {counted(sum(t.messages for t in recording.topics), 'message')}"]
    if span is not None:
        lines.append(f"time      {utc(span[0])} to {utc(span[1])}, {(span[1] - span[0]) / 1e9:.3f} s")
    lines += [f"topic     {t.name}: {t.messages} x {t.schema or '(no schema)'}" for t in recording.topics]
    lines += [f"attached  {name}" for name in recording.attachments]
    lines += [f"epipolar  {line}" for line in _epipolar_lines(recording)]
    lines += [f"lost      {loss}" for loss in recording.losses]
    lines += _provenance_lines(recording.provenance.as_dict()) if recording.ours else []
    lines += _verdict_lines(recording.path)
    if recording.scene is not None:
        lines += ["", *_describe_scene(recording.scene).lines]
    values = {
        "kind": "recording",
        "topics": topics,
        "cameras": recording.cameras,
        "time_ns": span,
        "attachments": list(recording.attachments),
        "provenance": recording.provenance.as_dict() if recording.ours else None,
    }
    return Description(values, lines)


def _epipolar_lines(recording: McapRecording) -> Iterator[str]:
    """Generate a line for each pair of views with a fundamental matrix in a recording."""
    from occlog.io.formats.models.fundamental_matrices import attached_epipolar

    found = attached_epipolar(recording)
    for pair in found.pairs if found is not None else ():
        error = "" if math.isnan(pair.error_px) else f", lines to {pair.error_px:.2g} px"
        yield f"{pair.a}, {pair.b}: from {pair.source}{error}"


def _provenance_lines(p: Mapping[str, Any]) -> list[str]:
    seed = "" if p.get("seed") is None else f", seed {p['seed']}"
    lines = [f"made by   {p.get('program', '?')} {p.get('version', '?')} {p.get('command', '?')}{seed}"]
    versions = ", ".join(f"{name} {p['versions'][name]}" for name in SHOWN_VERSIONS if name in p.get("versions", {}))
    lines += [f"with      {versions}"] if versions else []
    lines += [f"from      {i['name']} (sha256 {i['sha256'][:12]}...)" for i in p.get("inputs", ())]
    return lines


def _verdict_lines(path: Path) -> list[str]:
    """Return lines on the verdicts of the stages that made a file: plausible or not, number of checks, findings."""
    from occlog.io.files.inputs import verdicts_of_file
    from occlog.records.verdicts import counts_of, found_by_stage, summary_of

    verdicts = verdicts_of_file(path)
    if not verdicts:
        return []
    lines = [f"plausible {plausible_in_words(summary_of(verdicts))}"]
    lines += [f"checked   {verdict.stage}: {counts_of(verdict.checks)}" for verdict in verdicts]
    return lines + [f"          {check.severity}: {stage}: {check.text}" for stage, check in found_by_stage(verdicts)]


def _describe_table(path: Path, rows: int) -> Description:
    from occlog.io.files.tables.parquet import describe as describe_parquet

    found = describe_parquet(path)
    lines = [f"table {found['schema']}, {counted(found['rows'], 'row')}"]
    if found["time_ns"]:
        start, end = found["time_ns"]
        lines.append(f"time      {utc(start)} to {utc(end)}, {(end - start) / 1e9:.3f} s")
    lines += _provenance_lines(found["provenance"]) if found["provenance"] else []
    lines += _verdict_lines(path)
    lines += [f"lost      {Loss(**loss)}" for loss in found["provenance"].get("losses", ())]
    lines += [f"column    {c['name']} [{c.get('unit', '?')}]: {c.get('doc', '')}" for c in found["columns"]]
    lines += _first_rows(path, rows) if rows and found["rows"] else []
    return Description({"kind": "table", **found}, lines)


def _describe_external(table: ExternalTable) -> Description:
    """Describe an external table: the occlog table that it is read as, and the meaning of each column."""
    source, layout = table.source, table.layout_of(table.widest(table.layout.table))
    used = {s.name: s for s in layout.columns}
    checked = {s.far: s.name for s in layout.columns if s.far}
    unit = table.length_unit or "the unit of the scene"
    rows = source.rows
    parts = f"{len(source.parts)} parts, " if source.parts else ""
    many = "" if rows is None else f"{parts}{rows} rows, "
    lines = [f"{source.kind} of another program, {many}read as {layout.table.NAME}, lengths in {unit}"]
    for name in source.names:
        spelled = used.get(name)
        unit = "" if spelled is None or not spelled.unit else f" [{_unit_of(spelled)}]"
        idle = f"compared with {checked[name]}" if name in checked else "not used"
        lines.append(f"column    {name}: {idle if spelled is None else spelled.column.name + unit}")
    values = {
        "kind": "foreign",
        "format": source.kind,
        "table": layout.table.NAME,
        "length_unit": table.length_unit,
        **({} if rows is None else {"rows": rows}),
        "columns": {name: used[name].column.name if name in used else None for name in source.names},
    }
    return Description(values, lines)


def _unit_of(spelled: Spelling) -> str:
    """Return the unit of an external column as text.

    For a derived unit with the length unit filled in, such as cm/s.
    """
    from occlog.records.columns import LENGTHS, in_length_unit

    return in_length_unit(spelled.column.unit, spelled.unit) if spelled.column.unit in LENGTHS else spelled.unit


def _first_rows(path: Path, rows: int) -> list[str]:
    """Return the first `rows` rows of a table as lines of text, right-aligned under column names."""
    from occlog.io.files.tables.parquet import first_rows

    columns = [
        ["time (t_ns)", *(time_words(v) if isinstance(v, int) else str(v) for v in values)]
        if name == "t_ns"
        else [name, *(f"{v:.6g}" if isinstance(v, float) and v == v else "NaN" if v != v else str(v) for v in values)]
        for name, values in first_rows(path, rows).items()
    ]
    widths = [max(map(len, column)) for column in columns]
    return ["", *(" ".join(map(str.rjust, row, widths)) for row in zip(*columns, strict=True))]
