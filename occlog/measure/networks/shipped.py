"""The person network shipped with occlog: its file, and default settings.

`MIN_CONFIDENCE` and `NMS_IOU` are the values with the best F1 on PETS 2009 S2.L1, view 1 (docs/how-to/detectors.md).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from importlib import resources
from pathlib import Path

from occlog.settings import configure

from .config import NetworkConfig

NAME = "nanodet.onnx"
MIN_CONFIDENCE = 0.4
NMS_IOU = 0.5


def shipped_network() -> Path:
    """Path of the person network that comes with occlog."""
    return Path(str(resources.files("occlog") / "networks" / NAME))


def shipped_config(given: Mapping[str, object]) -> NetworkConfig:
    """Settings of the person network of occlog, with its own IoU threshold, updated by those that the user gives."""
    return configure(replace(NetworkConfig(), nms_iou=NMS_IOU), given)
