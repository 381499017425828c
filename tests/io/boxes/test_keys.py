"""Every key of the samples of box files: a change changes boxes, is refused or noted, or is in `WITHOUT_EFFECT`."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from dataclasses import fields
from fractions import Fraction
from pathlib import Path
from xml.etree.ElementTree import fromstring, tostring

import pytest

from occlog.errors import InputError
from occlog.io.formats.boxes.reader import BoxFile, BoxOptions, BoxSurvey, read_boxes, survey_boxes
from occlog.io.frames.streams import rate_times
from occlog.records.tables import Boxes

BOX = {"xtl": "10.0", "ytl": "20.0", "xbr": "40.0", "ybr": "80.0", "occluded": "0", "z_order": "0", "rotation": "0"}
COCO: dict[str, object] = {
    "info": {"year": 2024},
    "licenses": [{"id": 1}],
    "videos": [{"id": 1, "name": "a", "width": 200, "height": 100, "fps": 25.0}],
    "images": [
        {"id": n, "file_name": f"a/{n:03}.png", "width": 200, "height": 100, "video_id": 1, "license": 1}
        | {"date_captured": "2024-01-01 00:00:00", "timestamp": 0.1 * n, "frame_id": n}
        for n in (0, 1)
    ],
    "annotations": [
        {"id": n, "image_id": n, "category_id": 1, "bbox": [10.0, 20.0, 30.0, 60.0], "area": 1800.0, "iscrowd": 0}
        | {"segmentation": [], "track_id": 3, "score": 0.8, "ignore": 0, "keypoints": [], "visibility": 1.0}
        | {"attributes": {"occluded": False, "rotation": 0.0}}
        for n in (0, 1)
    ],
    "categories": [{"id": 1, "name": "person", "supercategory": "person"}],
}
RESULTS = [
    {"image_id": n, "category_id": 1, "bbox": [10.0, 20.0, 30.0, 60.0], "score": 0.8, "track_id": 1, "area": 1800.0}
    for n in (0, 1)
]
RECORDS = [
    {"frame": n, "box": {"x1": 10.0, "y1": 20.0, "x2": 40.0, "y2": 80.0}, "confidence": 0.8, "class": 0, "track_id": 4}
    | {"name": "person"}
    for n in (0, 1)
]
WILDTRACK = [
    {
        "personID": 122,
        "positionID": 456826,
        "views": [{"viewNum": 0, "xmin": 15, "ymin": 13, "xmax": 45, "ymax": 98}],
    }
]
EDGES = " ".join(f'{key}="{value}"' for key, value in BOX.items())
TRACKS = f"""<annotations><meta><task><start_frame>0</start_frame><stop_frame>1</stop_frame><frame_filter>step=1
</frame_filter><original_size><width>200</width><height>100</height></original_size></task></meta>
<track id="3" label="person" source="manual"><box frame="0" keyframe="1" outside="0" {EDGES}/></track>
</annotations>"""
IMAGES = f"""<annotations><image id="0" name="f_000.png" width="200" height="100"><box label="person" source="manual"
 {EDGES}/></image><image id="1" name="f_005.png" width="200" height="100"/></annotations>"""
SAMPLES: dict[str, object] = {
    "coco.json": COCO,
    "results.json": RESULTS,
    "records.json": RECORDS,
    "tracks.xml": TRACKS,
    "images.xml": IMAGES,
    "wildtrack/000.json": WILDTRACK,
}
_OF_CVAT = {"occluded", "z_order", "source"}
WITHOUT_EFFECT = {
    "coco.json": {"year", "id", "license", "name", "width", "height", "file_name", "area", "segmentation", "keypoints"}
    | {"occluded", "supercategory", "sensor_mode"},
    "results.json": {"area"},
    "records.json": set(),
    "tracks.xml": {*_OF_CVAT, "keyframe", "sensor_mode"},
    "images.xml": {*_OF_CVAT, "sensor_mode", "id", "name"},
    "wildtrack/000.json": {"positionID", "sensor_mode"},
}
"""Keys that may be changed in silence: names of licences, the size of a video whose images have one, where a person
stands, how a box was drawn; the one of id and name of an image that does not number its frame; unknown keys of objects
other than boxes, images and videos."""


def changed(value: object) -> object:
    """Another value of the same kind."""
    if isinstance(value, bool):
        return not value
    return value + 1 if isinstance(value, int | float) else [1] if isinstance(value, list) else f"{value}x"


def mutants(tree: object) -> Iterator[tuple[str, object]]:
    """Each key in a nested sample, with the sample in which its value is another one, and with one key more."""
    if isinstance(tree, list):
        for name, inner in mutants(tree[0]) if tree else ():
            yield name, [inner, *tree[1:]]
    elif isinstance(tree, dict):
        yield "sensor_mode", {**tree, "sensor_mode": 3}
        for key, value in tree.items():
            inside = list(mutants(value)) if isinstance(value, dict | list) else []
            yield from ((name, {**tree, key: inner}) for name, inner in inside)
            if not inside:
                yield key, {**tree, key: changed(value)}


def elements(text: str) -> Iterator[tuple[str, str]]:
    """As `mutants`, of the attributes and texts of XML."""
    for n, each in enumerate(fromstring(text).iter()):
        for key in [*each.attrib, "sensor_mode"]:
            root = fromstring(text)
            value = list(root.iter())[n].get(key, "1")
            list(root.iter())[n].set(key, str(int(float(value)) + 1) if value[0].isdigit() else f"{value}x")
            yield key, tostring(root, encoding="unicode")
        if (each.text or "").strip():
            root = fromstring(text)
            list(root.iter())[n].text = "step=2" if "step" in str(each.text) else "3"
            yield each.tag, tostring(root, encoding="unicode")


def outcome(folder: Path, name: str, value: object) -> tuple[str, BoxSurvey | None]:
    """Boxes, classes and sizes, or the error, as text; and the survey."""
    path = folder / name
    path.parent.mkdir(exist_ok=True)
    path.write_text(value if isinstance(value, str) else json.dumps(value))
    if name.startswith("wildtrack"):
        path = path.parent
    named = name in ("coco.json", "wildtrack/000.json")
    try:
        options = BoxOptions(classes=())
        files = [BoxFile(path, None if named else "a")]
        survey = survey_boxes(files, (), options)
        times = {**dict.fromkeys(survey.cameras, rate_times(Fraction(10), "given")), **survey.times}
        boxes = Boxes.merge(list(read_boxes(files, survey, times, (), options, Boxes)))
    except InputError as error:
        return f"refused: {error}", None
    columns = [getattr(boxes, field.name).tolist() for field in fields(boxes)]
    return repr((columns, survey.sizes, survey.classes)), survey


@pytest.mark.parametrize("name", SAMPLES)
def test_no_key_is_changed_in_silence(tmp_path: Path, name: str) -> None:
    sample = SAMPLES[name]
    plain, _ = outcome(tmp_path, name, copy.deepcopy(sample))
    assert not plain.startswith("refused"), plain
    tried = list(elements(sample) if isinstance(sample, str) else mutants(sample))
    assert len(tried) >= 7
    silent = set()
    for key, mutant in tried:
        text, survey = outcome(tmp_path, name, mutant)
        noted = survey is not None and any(each.endswith(f".{key}") for each in survey.unused)
        if text == plain and not noted:
            silent.add(key)
    assert silent == WITHOUT_EFFECT[name]


def test_frames_of_cvat_are_the_numbers_of_images_that_skip_some(tmp_path: Path) -> None:
    _, survey = outcome(tmp_path, "images.xml", IMAGES)
    assert survey is not None
    assert survey.ranges == {"a": range(6)}
    _, survey = outcome(tmp_path, "images.xml", IMAGES.replace("f_005", "f_001"))
    assert survey is not None
    assert survey.ranges == {"a": range(2)}


def test_boxes_that_are_rotated_or_ignored_in_coco(tmp_path: Path) -> None:
    tree = copy.deepcopy(COCO)
    tree["annotations"][0]["attributes"]["rotation"] = 30.0  # type: ignore[index]
    assert outcome(tmp_path, "coco.json", tree)[0].startswith("refused: ")
    tree["annotations"][0] |= {"attributes": {}, "ignore": 1}  # type: ignore[index]
    _, survey = outcome(tmp_path, "coco.json", tree)
    assert survey is not None
    assert survey.rows == 1
