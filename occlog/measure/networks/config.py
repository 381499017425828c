"""Settings of networks that detect or describe people, and the constants that the provenance records with them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import Settings, setting

OPENCV, ONNXRUNTIME, OPENVINO = "opencv", "onnxruntime", "openvino"
"""Programs that run networks."""
YOLOV5, YOLO, END2END, RFDETR, DETR, ULTRALYTICS_DETR, RTDETR, RTMDET = (
    "yolov5",
    "yolo",
    "end2end",
    "rfdetr",
    "detr",
    "ultralytics-detr",
    "rtdetr",
    "rtmdet",
)
"""Kinds of network outputs; see `heads`."""
LETTERBOX, CORNER, STRETCH = "letterbox", "corner", "stretch"
"""Ways of resizing an image to the network's size: with a border around it, at the right and below, or stretched."""
UNIT, IMAGENET, IMAGENET_BGR, RAW = "unit", "imagenet", "imagenet-bgr", "raw"
"""Encodings of a pixel's colours; see `images.PIXELS`."""
PAD = 114
"""Grey of the border."""
MAX_CROPS = 32
"""Boxes that a network describes in one batch."""
LONGEST_VECTOR = 8192
"""Dimension of an appearance vector of a person."""
LARGEST_SIDE = 8192
"""Longest side of a network's images [px]."""


@dataclass(frozen=True)
class NetworkConfig(Settings):
    """Settings of detection by a network."""

    OWNER: ClassVar[str] = "network"

    runtime: str = setting(
        OPENCV,
        "What runs the networks; the others are extras to install.",
        choices=(OPENCV, ONNXRUNTIME, OPENVINO),
        option="--runtime",
    )
    head: str | None = setting(
        None,
        "What the network's numbers mean.",
        choices=(YOLOV5, YOLO, END2END, RFDETR, DETR, ULTRALYTICS_DETR, RTDETR, RTMDET),
        option="--head",
        nothing="from the names and shapes of its outputs",
    )
    overlap: float = setting(
        0.7,
        "Of two boxes of a class whose intersection over union is above this, that of less confidence is left out; "
        "only where the network itself leaves such boxes in.",
        at_least=0,
        at_most=1,
        option="--overlap",
    )
    fit: str | None = setting(
        None,
        "How images are brought to the network's size.",
        choices=(LETTERBOX, CORNER, STRETCH),
        option="--fit",
        nothing="as the head's makers do",
    )
    pixels: str | None = setting(
        None,
        "Colours as numbers: 0 to 1, by ImageNet's means and deviations in RGB or BGR, or 0 to 255.",
        choices=(UNIT, IMAGENET, IMAGENET_BGR, RAW),
        option="--pixels",
        nothing="as the head's makers do",
    )
    size: str | None = setting(
        None,
        "Size of the network's images, where the network leaves it open.",
        unit="px",
        option="--size",
        metavar="[WIDTHx]HEIGHT",
        nothing="the network's own",
    )
    batch: int = setting(
        1,
        "Images given to the network at a time, where the network leaves that open.",
        at_least=1,
        at_most=256,
        option="--batch",
    )
    embed_pixels: str = setting(
        IMAGENET,
        "The same as --pixels for the network of --embed.",
        choices=(UNIT, IMAGENET, IMAGENET_BGR, RAW),
        option="--embed-pixels",
    )
    embed_size: str | None = setting(
        None,
        "Size of its images, where it leaves that open.",
        unit="px",
        option="--embed-size",
        metavar="[WIDTHx]HEIGHT",
        nothing="its own",
    )
