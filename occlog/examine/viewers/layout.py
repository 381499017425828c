"""The layout of panels that Foxglove and Lichtblick import, for the topics of one file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from occlog.examine.viewers.drawings.world import world_of
from occlog.records.scene import Scene
from occlog.settings import METRES

from .time_stream import PARTICLES

MAX_CAMERAS, MAX_LINES = 6, 8
"""Images in the layout; lines of a plot. The rest is added by hand."""
PLOTS = (
    ("errors", ("error",)),
    ("diagnostics", ("ess",)),
    ("tracks", ("existence_probability",)),
    ("tracks", ("x", "y")),
)
"""Numbers that are plotted, the first two of which there are topics."""
TRANSFORMS = {"showLabel": False, "labelSize": 0, "lineWidth": 0, "axisScale": 0.5, "enablePreloading": True}
"""Sensors have names in the plan; lines from each to the origin hide more than they show."""
Node = str | dict[str, object]


def foxglove_layout(topics: Mapping[str, str], scene: Scene | None) -> dict[str, object]:
    """Return a layout of panels for Foxglove and Lichtblick: 3-D scene, images, plots and log.

    Args:
        topics: name of the message schema of each topic.
        scene: determines the initial view in space; None: the origin.
    """
    panels: dict[str, object] = {"3D!space": _space(topics, scene)}
    images: list[Node] = []
    cameras = [topic.split("/")[2] for topic in topics if topic.endswith("/image")]
    for name in cameras[:MAX_CAMERAS]:
        panels[f"Image!{name}"] = _image(name, topics)
        images.append(f"Image!{name}")
    below: list[Node] = []
    for n, paths in enumerate(_plots(topics)):
        panels[f"Plot!{n}"] = _plot(paths)
        below.append(f"Plot!{n}")
    if "/log" in topics:
        panels["RosOut!log"] = {"topicToRender": "/log", "minLogLevel": 1, "searchTerms": []}
        below.append("RosOut!log")
    upper = _split("3D!space", _tiled(images, "column"), "row", 55) if images else "3D!space"
    layout = _split(upper, _tiled(below, "row"), "column", 70) if below else upper
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": layout,
    }


def _split(first: Node, second: Node, direction: str, share: float) -> dict[str, object]:
    return {"first": first, "second": second, "direction": direction, "splitPercentage": share}


def _tiled(panels: Sequence[Node], direction: str) -> Node:
    """Return a tree of panels arranged in a `direction`, `row` or `column`; from four on, directions alternate."""
    if len(panels) == 1:
        return panels[0]
    if len(panels) == 2:
        return _split(panels[0], panels[1], direction, 50)
    half = (len(panels) + 1) // 2
    if len(panels) > 3:
        other = "row" if direction == "column" else "column"
        return _split(_tiled(panels[:half], other), _tiled(panels[half:], other), direction, 50)
    return _split(panels[0], _tiled(panels[1:], direction), direction, 100 / len(panels))


def _space(topics: Mapping[str, str], scene: Scene | None) -> dict[str, object]:
    shown: dict[str, object] = {
        t: {"visible": not t.startswith("/shadows")} for t, s in topics.items() if s == "foxglove.SceneUpdate"
    }
    cone = {"visible": True, "distance": 1, "planarProjectionFactor": 1}
    if PARTICLES in topics:
        shown[PARTICLES] = {"visible": True, "colorMode": "rgba-fields", "pointSize": 2, "pointShape": "circle"}
    shown |= {t: cone for t in topics if t.endswith("/calibration")}
    middle, size = np.zeros(2), 10.0
    if scene is not None and (scene.room is not None or scene.cameras or scene.arrays):
        corners = METRES.get(scene.length_unit, 1.0) * scene.surroundings
        middle, size = 0.5 * (corners.min(axis=0) + corners.max(axis=0)), float(np.ptp(corners, axis=0).max())
    return {
        "followTf": world_of(scene),
        "followMode": "follow-none",
        "topics": shown,
        "cameraState": {
            "perspective": True,
            "distance": 1.6 * size,
            "phi": 40,
            "thetaOffset": 20,
            "targetOffset": [*middle.tolist(), 0],
            "target": [0, 0, 0],
            "targetOrientation": [0, 0, 0, 1],
            "fovy": 45,
            "near": 0.1,
            "far": 5000,
        },
        "scene": {"transforms": TRANSFORMS},
        "layers": {},
    }


def _image(camera: str, topics: Mapping[str, str]) -> dict[str, object]:
    base = f"/camera/{camera}"
    mode: dict[str, object] = {"imageTopic": f"{base}/image"}
    if f"{base}/calibration" in topics:
        mode["calibrationTopic"] = f"{base}/calibration"
    layers = [topic for topic in topics if topic.startswith(f"{base}/image/")]
    tracked = f"{base}/image/annotations" in layers
    mode["annotations"] = {t: {"visible": t.endswith("/annotations") or not tracked} for t in layers}
    return {
        "imageMode": mode,
        "scene": {"transforms": TRANSFORMS},
        "topics": {},
        "layers": {},
        "synchronize": False,
    }


def _plots(topics: Mapping[str, str]) -> list[list[str]]:
    """Return the message paths of up to two plots, each with up to `MAX_LINES` lines.

    `topics`: name of the message schema of each topic.
    """
    found = []
    for source, names in PLOTS:
        targets = [topic for topic in topics if topic.startswith(f"/{source}/")]
        paths = [f"{topic}.{name}" for topic in targets for name in names][:MAX_LINES]
        found += [paths] if paths else []
    return found[:2]


def _plot(paths: Sequence[str]) -> dict[str, object]:
    lines = [{"value": path, "enabled": True, "timestampMethod": "receiveTime"} for path in paths]
    return {
        "paths": lines,
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "showLegend": True,
        "legendDisplay": "floating",
        "isSynced": True,
        "xAxisVal": "timestamp",
        "sidebarDimension": 240,
    }
