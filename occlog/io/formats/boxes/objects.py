"""Boxes in JSON: COCO, the records of supervision and Ultralytics, and one record a line.

COCO        images, annotations and categories; or a list of results with image_id and bbox, one camera
records     a list of objects, or one a line: frame, box edges under any of the names that a CSV may have,
            `box` with x1, y1, x2, y2 (Ultralytics), or `bbox` [left, top, width, height]
by frames   a list of lists of such objects, or one list a line, frame by frame from 0
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np

from occlog.errors import InputError, option
from occlog.io.files.names import last_number
from occlog.io.files.texts.csv_rows import CsvRows
from occlog.io.files.texts.documents import check_number, parse_json
from occlog.records.declared.sensors import MAX_FRAMES

from .columns import (
    BOX,
    CLASS_KEYS,
    COLUMNS,
    EDGES,
    IGNORED,
    ROTATED,
    WHAT,
    BoxReadOptions,
    BoxSource,
    check_columns,
    chunks_of,
    stated_sizes,
)

MAX_BYTES = 2**31
BBOX = ("left", "top", "width", "height")
LABEL_STUDIO = {"annotations", "annotation_id", "annotator", "lead_time"}
"""Keys of tasks of Label Studio, of which its JSON and JSON-MIN have one or more."""
FRAME_KEYS = ("frame", "frame_id", "frame_index", "frame_number")
COCO_KEYS = {
    "images": {"id", "file_name", "width", "height", "camera", "video_id", "t_ns", "license", "flickr_url", "coco_url"}
    | set(FRAME_KEYS),
    "annotations": {"id", "image_id", "category_id", "bbox", "area", "iscrowd", "ignore", "segmentation", "keypoints"}
    | {"num_keypoints", "track_id", "tracker_id", "instance_id", "score", "confidence", "attributes", "rotation"},
    "videos": {"id", "name", "width", "height", "file_name"},
}
"""Keys of the entries of COCO's lists that are used, or do not change a box, its frame or its time."""
MEANING = {alias: name for name, aliases in {**COLUMNS, **CLASS_KEYS}.items() for alias in aliases}
Record = Mapping[str, Any]


def open_json(path: Path, wanted: BoxReadOptions) -> BoxSource:
    """Open the boxes in a JSON file: COCO, COCO results, records of other programs, or lists by frame.

    It must name its cameras, unless `wanted` states the camera.

    Raises:
        InputError: it is not JSON, in none of these forms, or the camera is not known.
    """
    camera, ignore_extra = wanted.camera, wanted.ignore_extra
    value = _load(path)
    if isinstance(value, dict) and isinstance(value.get("images"), list):
        return _coco(path, value, camera)
    if isinstance(value, dict) and isinstance(value.get("annotations"), list) and "images" not in value:
        boxes = [each for each in value["annotations"] if isinstance(each, dict) and "image_id" in each]
        if boxes:
            raise InputError(
                f"{path}: is COCO without images, and their names state the frames; add them, or write the list of "
                "annotations alone",
                id="missing-column",
            )
    if isinstance(value, dict):
        value = [value]
    if value and all(isinstance(part, list) for part in value):
        records = [(n, record) for n, part in enumerate(value) for record in part]
        listed = np.arange(len(value), dtype=np.int64)
        rows = _rows(path, [(record, {"frame": str(n)}) for n, record in records], camera, ignore_extra)
        return BoxSource(rows, "JSON by frames", {"": listed})
    for n, record in enumerate(value, start=1):
        if not isinstance(record, dict):
            raise _no_object(path, n, record)
    if value and "image_id" in value[0] and "bbox" in value[0]:
        if camera is None:
            raise InputError(
                f"{path}: COCO results do not name their camera; give CAMERA={path.name}, or COCO with its images",
                id="camera-not-named",
            )
        given = [(record, {"frame": _image_number(path, n, record)}) for n, record in enumerate(value, start=1)]
        folders = [str(Path(record["image_id"]).parent) for record, _ in given if isinstance(record["image_id"], str)]
        if len(set(folders)) > 1:
            raise InputError(
                f"{path}: images of the folders {' and '.join(sorted(set(folders))[:2])}, which are not one camera; "
                "give COCO with its images, or a file for each",
                id="ambiguous-input",
            )
        return BoxSource(_rows(path, given, camera, ignore_extra, skip=("image_id", "id")), "COCO results")
    nothing: dict[str, str] = {}
    return BoxSource(_rows(path, [(record, nothing) for record in value], camera, ignore_extra), "JSON records")


def _no_object(path: Path, n: int, record: object) -> InputError:
    return InputError(f"{path}: entry {n}: {str(record)[:40]!r}; an object with a box was expected")


def _load(path: Path) -> Any:
    """Value of a JSON file; for one with a value on each line, the list of these.

    InputError if it is neither, too large, or not UTF-8.
    """
    if path.stat().st_size > MAX_BYTES:
        raise InputError(
            f"{path}: {path.stat().st_size} bytes; JSON of at most {MAX_BYTES} can be read; split it",
            id="input-too-large",
        )
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: byte {error.start}: not UTF-8 text; {WHAT} was expected", id="wrong-encoding"
        ) from None
    try:
        return parse_json(text, path, WHAT)
    except InputError as error:
        if "Extra data" not in str(error):
            raise
    check_number(text.count("\n"), "lines", len(text), path)
    lines = enumerate(text.splitlines(), start=1)
    return [parse_json(line, f"{path}: record in line {number}", WHAT) for number, line in lines if line.strip()]


def _rows(
    path: Path,
    records: Sequence[tuple[object, dict[str, str]]],
    camera: str | None,
    ignore_extra: bool,
    skip: Sequence[str] = (),
) -> Iterator[CsvRows]:
    """Yield rows made of JSON records, in chunks.

    Args:
        path: the file.
        records: each with additional cells that override its own.
        camera: the one that the user states; None: records name it.
        ignore_extra: skip unknown keys instead of refusing them.
        skip: keys that are not used.
    """
    cells = (
        (n, {**_cells(path, n, record, ignore_extra, skip), **known})
        for n, (record, known) in enumerate(records, start=1)
    )
    for rows in chunks_of(path, cells, "entry"):
        yield check_columns(rows, camera)


def _cells(path: Path, n: int, record: object, ignore_extra: bool, skip: Sequence[str]) -> dict[str, str]:
    """Cells of one JSON record as text, by occlog's column names; boxes are split into edges or sizes.

    Args:
        path: the file.
        n: number of the record, for messages.
        record: JSON object.
        ignore_extra: skip unknown keys instead of refusing them.
        skip: keys that are not used.

    Raises:
        InputError: a key is unknown, two keys have one meaning, or a value is invalid.
    """
    if not isinstance(record, dict):
        raise _no_object(path, n, record)
    if LABEL_STUDIO & record.keys():
        raise InputError(
            f"{path}: is JSON of Label Studio, which is not read; export it as COCO or YOLO", id="unsupported-format"
        )
    out: dict[str, str] = {}
    reported: dict[str, str] = {}
    for key, value in record.items():
        name = key.lower()
        if name in skip or name in IGNORED:
            continue
        for meaning in BBOX if name == "bbox" else EDGES.values() if name == BOX else (MEANING.get(name, name),):
            other = reported.setdefault(meaning, key)
            if other != key:
                raise InputError(
                    f"{path}: entry {n}: keys {other!r} and {key!r} both state {meaning}; leave one out",
                    id="conflicting-values",
                )
        if name == BOX and isinstance(value, dict):
            if set(value) != set(EDGES):
                raise InputError(f"{path}: entry {n}: box has {', '.join(value)}; expected {', '.join(EDGES)}")
            out |= {EDGES[edge]: _text(path, n, edge, number) for edge, number in value.items()}
        elif name in (BOX, "boxes") and isinstance(value, list):
            raise InputError(
                f"{path}: entry {n}: {key} is a list; write an object for each box, with frame and "
                "bbox: [left, top, width, height], or left, top, right and bottom"
            )
        elif name == "bbox":
            if not isinstance(value, list) or len(value) != 4:
                raise InputError(f"{path}: entry {n}: bbox is {str(value)[:60]}; expected [left, top, width, height]")
            out |= {side: _text(path, n, "bbox", number) for side, number in zip(BBOX, value, strict=True)}
        elif name in MEANING:
            out[MEANING[name]] = _text(path, n, key, value)
        elif not ignore_extra:
            near = get_close_matches(name, list(MEANING), n=1, cutoff=0.5)
            hint = f"did you mean {near[0]!r}? " if near else ""
            raise InputError(
                f"{path}: entry {n}: unknown key {key!r}; {hint}rename it, or skip unknown keys "
                f"({option('ignore_extra_columns')})",
                id="unknown-column",
            )
    return out


def _text(path: Path, n: int, key: str, value: object) -> str:
    """Text of a cell from a JSON value; empty for null. InputError for lists, objects and Booleans.

    `n` and `key` are the number of the entry and the key, for the message.
    """
    if value is None:
        return ""
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise InputError(f"{path}: entry {n}: {key} is {str(value)[:40]}; a number or text was expected")
    return str(value) if isinstance(value, str) else repr(value)


def _image_number(path: Path, n: int, record: Record) -> str:
    """Frame number, as text, of a COCO result: its `image_id`, or the last number in it if it is a file name.

    InputError if there is none; `n` is the number of the entry.
    """
    image = record.get("image_id")
    found = last_number(Path(image).stem) if isinstance(image, str) else None
    if isinstance(image, int) and not isinstance(image, bool):
        return str(image)
    if found is None:
        raise InputError(
            f"{path}: entry {n}: image_id is {str(image)[:40]!r}; a number was expected, that of the frame"
        )
    return found


def _coco(path: Path, value: Record, camera: str | None) -> BoxSource:
    """Boxes of a COCO data set; frames and cameras are those of its images; crowds (`iscrowd`, `ignore`) are omitted.

    Args:
        path: the file.
        value: its JSON object.
        camera: the one that the user states; None: images name it.

    Raises:
        InputError: two images are of one frame, an annotation is of no image, or an entry is invalid.
    """
    images: dict[object, dict[str, str]] = {}
    seen: dict[tuple[str, str], object] = {}
    origins: dict[str, str] = {}
    files: dict[object, str] = {}
    timed = all(isinstance(image, dict) and isinstance(image.get("t_ns"), int) for image in value["images"])
    for n, image in enumerate(value["images"], start=1):
        cells = _image(path, n, image, camera) | ({"ns": str(image["t_ns"])} if timed else {})
        _check_origin(path, n, image, camera, origins.setdefault(cells.get("camera", ""), _origin(image)))
        key = (cells.get("camera", ""), cells["frame"])
        name = str(image.get("file_name", ""))
        if files.setdefault(image["id"], name) != name:
            raise InputError(
                f"{path}: image {n}: its id {image['id']} is that of {files[image['id']]} and of {name}, as of two "
                f"exports that were merged; give each export by itself ({option('boxes')}), or renumber the images of "
                "one with their annotations",
                id="duplicate-row",
            )
        if image.get("id") in images or key in seen:
            other = image["id"] if image["id"] in images else seen[key]
            raise InputError(
                f"{path}: image {n}: is the same image or frame as image {other}; keep one", id="duplicate-row"
            )
        images[image["id"]], seen[key] = cells, image["id"]
    annotations = value.get("annotations")
    if not isinstance(annotations, list):
        raise InputError(
            f"{path}: COCO without annotations; expected images, annotations and categories", id="unknown-format"
        )
    names = _categories(path, value.get("categories") or [])
    records = []
    for n, annotation in enumerate(annotations, start=1):
        owner = annotation.get("image_id") if isinstance(annotation, dict) else None
        if not isinstance(owner, int | str) or owner not in images:
            raise InputError(f"{path}: annotation {n}: its image_id is that of no image; correct it")
        if annotation.get("iscrowd") or annotation.get("ignore"):
            continue
        records.append((n, _annotation(path, n, annotation, names) | images[owner]))
    listed: dict[str, list[int]] = {}
    for cells in images.values():
        listed.setdefault(cells.get("camera", ""), []).append(int(cells["frame"]))
    cameras = tuple(dict.fromkeys(cells["camera"] for cells in images.values() if "camera" in cells))
    sizes = stated_sizes(
        (images[image["id"]].get("camera", ""), image.get("width"), image.get("height")) for image in value["images"]
    )
    numbers = {label: np.array(sorted(each), dtype=np.int64) for label, each in listed.items()}
    lists = {"annotations": annotations, **{key: value.get(key) for key in ("images", "videos")}}
    unused = {
        f"{name}.{key}": None
        for name, each in lists.items()
        for entry in (each if isinstance(each, list) else [])
        for key in (entry if isinstance(entry, dict) else {})
        if key not in COCO_KEYS[name]
    }
    return BoxSource(_chunks(path, records), "COCO", numbers, cameras, sizes=sizes, unused=tuple(unused))


def _categories(path: Path, categories: object) -> dict[object, str]:
    """Names of the COCO classes by their ids.

    Args:
        path: the file, for messages.
        categories: value of `categories` in the file.

    Raises:
        InputError: `categories` is not a list of objects with ids, or classes of different names have one id.
    """
    if not isinstance(categories, list):
        raise InputError(f"{path}: categories of COCO are {str(categories)[:40]}; a list was expected")
    names: dict[object, str] = {}
    for n, category in enumerate(categories, start=1):
        if not isinstance(category, dict) or not isinstance(category.get("id"), int | str):
            raise InputError(f"{path}: category {n}: has no id", id="missing-value")
        name = str(category.get("name"))
        if names.setdefault(category["id"], name) != name:
            raise InputError(
                f"{path}: category {n}: has the id of {names[category['id']]!r}; give each its own", id="duplicate-name"
            )
    return names


def _chunks(path: Path, records: Sequence[tuple[int, Mapping[str, str]]]) -> Iterator[CsvRows]:
    return chunks_of(path, sorted(records, key=lambda pair: int(pair[1]["frame"])), "annotation")


def _image(path: Path, n: int, image: object, camera: str | None) -> dict[str, str]:
    """Frame and camera of a COCO image as cells; without the camera if the user states it (`camera`).

    The frame is the number that the image states, or the last number in its file name; the camera the one that it
    states, or its folder. `n` is the number of the image, for messages.

    Raises:
        InputError: the image has no id, frame number or camera.
    """
    if not isinstance(image, dict) or not isinstance(image.get("id"), int | str):
        raise InputError(f"{path}: image {n}: has no id", id="missing-value")
    name = str(image.get("file_name", ""))
    key = next((k for k in FRAME_KEYS if isinstance(image.get(k), int)), None)
    found = last_number(Path(name).stem)
    if key is None and found is None:
        raise InputError(
            f"{path}: image {n}: file_name {name!r} has no number of the frame; give each image a key frame with it",
            id="missing-value",
        )
    number = str(image[key] + 0) if key else found.lstrip("0") or "0" if found else "0"
    if len(number) > len(str(MAX_FRAMES)) or not 0 <= int(number) < MAX_FRAMES:
        raise InputError(
            f"{path}: image {n}: frame {number:.24}; it must be 0 or more, and below {MAX_FRAMES}; if it is a time, "
            "give each image a key frame with its number"
        )
    out = {"frame": number}
    if camera is None:
        out["camera"] = _camera_of(image)
        if not out["camera"]:
            raise InputError(
                f"{path}: image {n}: file_name {name!r} has no folder named after its camera; give CAMERA={path.name}",
                id="camera-not-named",
            )
    return out


def _camera_of(image: Record) -> str:
    """Camera that a COCO image names, or its folder; empty if neither is stated."""
    return str(image.get("camera") or _folder(image).name)


def _folder(image: Record) -> Path:
    return Path(str(image.get("file_name", "")).replace("\\", "/")).parent


def _origin(image: Record) -> str:
    """Text on where a COCO image is from: the camera that it names, or else its folder and video."""
    if image.get("camera"):
        return f"camera {image['camera']}"
    video = f", video {image['video_id']}" if "video_id" in image else ""
    return f"folder {_folder(image)}{video}"


def _check_origin(path: Path, n: int, image: Record, camera: str | None, first: str) -> None:
    """InputError if a COCO image is from another camera, folder or video than the first image of its camera.

    Args:
        path: the file.
        n: number of the image, for messages.
        image: the COCO image.
        camera: the one that the user states; None: images name it.
        first: origin of the first image, as `_origin` returns it.
    """
    if _origin(image) == first:
        return
    owner = f"camera {camera or _camera_of(image)}"
    raise InputError(
        f"{path}: image {n}: is of {_origin(image)}, and the first image of {owner} of {first}; "
        + (f"omit {camera}=, so that each folder is a camera, or " if camera is not None else "")
        + "give every image a key camera",
        id="image-size-mismatch",
    )


def _annotation(path: Path, n: int, annotation: Record, names: Mapping[object, str]) -> dict[str, str]:
    """Box, class, score and identity of a COCO annotation, as cells.

    `n` is its number, for messages; `names` are the names of the classes by id.

    Raises:
        InputError: its bbox is not a list of four numbers.
    """
    box = annotation.get("bbox")
    if not isinstance(box, list) or len(box) != 4:
        raise InputError(f"{path}: annotation {n}: bbox is {str(box)[:60]}; expected [left, top, width, height]")
    out = {side: _text(path, n, "bbox", number) for side, number in zip(BBOX, box, strict=True)}
    extra = annotation.get("attributes")
    given = {**(extra if isinstance(extra, dict) else {}), **annotation}
    if given.get("rotation"):
        raise InputError(f"{path}: annotation {n}: {ROTATED}", id="unsupported-format")
    identity = next((given[k] for k in ("track_id", "tracker_id", "instance_id") if k in given), None)
    score = next((given[k] for k in ("score", "confidence") if k in given), None)
    category = annotation.get("category_id")
    out |= {"class:category_id": _text(path, n, "category_id", category), "class:name": names.get(category, "")}
    return out | {"id": _text(path, n, "track_id", identity), "confidence": _text(path, n, "score", score)}
