"""Settings of networks that detect or describe people, and the constants that the provenance records with them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import Settings, option_setting

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
"""Encodings of a pixel's colours; see `network.PIXELS`."""
PAD = 114
"""Grey of the border."""
MAX_CROPS = 32
"""Boxes that a network describes in one batch."""
LONGEST_VECTOR = 8192
"""Dimension of an appearance vector of a person."""
MAX_TILES = 16
"""Tiles of an image in a row or in a column."""
TILE_OVERLAP = 0.2
"""Share of its side by which a tile overlaps the next."""
CUT_PX = 2.0
"""Distance from an inner edge of its tile within which an object is cut off there [px of the network's image]."""
LARGEST_SIDE = 8192
"""Longest side of a network's images [px]."""


@dataclass(frozen=True)
class NetworkConfig(Settings):
    """Settings of detection by a network."""

    OWNER: ClassVar[str] = "network"

    runtime: str = option_setting(
        OPENCV, "Runtime of the networks; the others are extras to install.", choices=(OPENCV, ONNXRUNTIME, OPENVINO)
    )
    head: str | None = option_setting(
        None,
        "Output format of the network.",
        choices=(YOLOV5, YOLO, END2END, RFDETR, DETR, ULTRALYTICS_DETR, RTDETR, RTMDET),
        nothing="from the names and shapes of its outputs",
    )
    nms_iou: float = option_setting(
        0.7,
        "IoU threshold of non-maximum suppression: of two boxes of a class that overlap more, the less confident "
        "is removed. Only for networks without their own suppression. Lower values lose close people. The network of "
        "occlog has 0.5 unless it is given.",
        at_least=0,
        at_most=1,
    )
    resize_mode: str | None = option_setting(
        None,
        "How images are scaled to the input size of the network.",
        choices=(LETTERBOX, CORNER, STRETCH),
        nothing="as in the original implementation of the head",
    )
    pixel_scaling: str | None = option_setting(
        None,
        "Scaling of colours: 0 to 1 (unit), ImageNet means and deviations in RGB or BGR, or 0 to 255 (raw).",
        choices=(UNIT, IMAGENET, IMAGENET_BGR, RAW),
        nothing="as in the original implementation of the head",
    )
    size: str | None = option_setting(
        None,
        "Input size, where the network leaves it open. Larger images show smaller people and take longer.",
        unit="px",
        metavar="[WIDTHx]HEIGHT",
        nothing="the network's own",
    )
    tiles: str | None = option_setting(
        None,
        "Detect in COLUMNS x ROWS overlapping tiles of the image, too, for people who are small in it. Each tile costs "
        "as much time as the whole image.",
        metavar="COLUMNSxROWS",
        nothing="the whole image alone",
    )
    batch: int = option_setting(
        1, "Images per call of the network, where the network leaves it open.", at_least=1, at_most=256
    )
    embed_pixel_scaling: str = option_setting(
        IMAGENET, "As --pixel-scaling, for the network of --embed.", choices=(UNIT, IMAGENET, IMAGENET_BGR, RAW)
    )
    embed_size: str | None = option_setting(
        None,
        "Input size of the network of --embed, where it leaves that open.",
        unit="px",
        metavar="[WIDTHx]HEIGHT",
        nothing="its own",
    )
