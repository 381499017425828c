"""Small networks in ONNX whose outputs are known by construction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest

onnx = pytest.importorskip("onnx")
TensorProto, helper, numpy_helper = onnx.TensorProto, onnx.helper, onnx.numpy_helper
OPSET = 13


def save(
    path: Path,
    nodes: Sequence[object],
    constants: Mapping[str, np.ndarray],
    outputs: Mapping[str, Sequence[int | str | None]],
    *,
    image: Sequence[int | str] = (1, 3, 64, 64),
    extent: bool = False,
    metadata: Mapping[str, str] | None = None,
    kinds: Mapping[str, int] | None = None,
) -> Path:
    """A network with an input `images`, perhaps `orig_target_sizes`, and outputs of these shapes."""
    inputs = [helper.make_tensor_value_info("images", TensorProto.FLOAT, list(image))]
    if extent:
        inputs.append(helper.make_tensor_value_info("orig_target_sizes", TensorProto.INT64, [image[0], 2]))
    graph = helper.make_graph(
        list(nodes),
        "small",
        inputs,
        [
            helper.make_tensor_value_info(name, (kinds or {}).get(name, TensorProto.FLOAT), list(shape))
            for name, shape in outputs.items()
        ],
        [numpy_helper.from_array(np.asarray(value), name) for name, value in constants.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=8)
    for key, text in (metadata or {}).items():
        model.metadata_props.add(key=key, value=text)
    onnx.save(model, str(path))
    return path


def constant_network(
    path: Path,
    outputs: Mapping[str, np.ndarray],
    *,
    image: Sequence[int | str] = (1, 3, 64, 64),
    metadata: Mapping[str, str] | None = None,
) -> Path:
    """A network that gives these arrays (1, ...) for every image of a batch."""
    # 0 times the mean of each image brings the batch in.
    nodes = [
        helper.make_node("ReduceMean", ["images"], ["mean"], axes=[1, 2, 3], keepdims=0),
        helper.make_node("Mul", ["mean", "zero"], ["nothing"]),
    ]
    constants: dict[str, np.ndarray] = {"zero": np.zeros(1, np.float32)}
    for name, values in outputs.items():
        constants |= {f"{name}_values": np.asarray(values, np.float32)}
        constants |= {f"{name}_shape": np.array([-1] + [1] * (values.ndim - 1), np.int64)}
        nodes.append(helper.make_node("Reshape", ["nothing", f"{name}_shape"], [f"{name}_nothing"]))
        nodes.append(helper.make_node("Add", [f"{name}_values", f"{name}_nothing"], [name]))
    shapes = {name: [image[0], *values.shape[1:]] for name, values in outputs.items()}
    return save(path, nodes, constants, shapes, image=image, metadata=metadata)


def colour_network(path: Path, *, image: Sequence[int | str] = (1, 3, 64, 64), red_first: bool = True) -> Path:
    """A network that finds the pixels in plain red, as YOLOv8 tells boxes: (B, 5, H * W) of one class.

    The boxes are single pixels of the network's image; their score is 1 where red is above 0.9 and green and blue
    below 0.1, numbers being 0 to 1.
    """
    height, width = int(image[2]), int(image[3])
    weights = np.array([1.0, -1.0, -1.0] if red_first else [-1.0, -1.0, 1.0], np.float32).reshape(1, 3, 1, 1)
    rows, columns = np.mgrid[:height, :width].astype(np.float32) + 0.5
    boxes = np.stack([columns.ravel(), rows.ravel(), np.ones(rows.size), np.ones(rows.size)]).astype(np.float32)
    nodes = [
        # 20 (red - green - blue - 0.9) cut to 0 to 1
        helper.make_node("Conv", ["images", "weights", "bias"], ["redness"], kernel_shape=[1, 1]),
        helper.make_node("Clip", ["redness", "low", "high"], ["score"]),
        helper.make_node("Reshape", ["score", "flat"], ["scores"]),
        helper.make_node("Mul", ["scores", "zero"], ["nothing"]),
        helper.make_node("Add", ["boxes", "nothing"], ["places"]),
        helper.make_node("Concat", ["places", "scores"], ["output0"], axis=1),
    ]
    constants = {
        "weights": 20.0 * weights,
        "bias": np.array([-17.0], np.float32),
        "low": np.float32(0),
        "high": np.float32(1),
        "flat": np.array([0, 1, height * width], np.int64),
        "zero": np.zeros(1, np.float32),
        "boxes": boxes[None],
    }
    return save(path, nodes, constants, {"output0": [image[0], 5, height * width]}, image=image)


def people_network(
    path: Path,
    *,
    image: Sequence[int | str] = ("n", 3, 120, 160),
    channels: Sequence[int] = (0, 2),
    metadata: Mapping[str, str] | None = None,
) -> Path:
    """A network that finds one person in plain red, one in plain green, one in plain blue: (B, K, 6) as YOLOv10 does.

    A pixel is of the person of channel c (0 red, 1 green, 2 blue) where c is above the sum of the others by 0.3; the
    box is around all of these pixels, its score is 0 where there are none.
    """
    height, width = int(image[2]), int(image[3])
    weights = np.full((len(channels), 3, 1, 1), -20.0, np.float32)
    for k, c in enumerate(channels):
        weights[k, c] = 20.0
    constants = {
        "weights": weights,
        "bias": np.full(len(channels), -6.0, np.float32),
        "low": np.float32(0),
        "high": np.float32(1),
        "flat": np.array([0, len(channels), 1], np.int64),
        "zero": np.zeros(1, np.float32),
        "right_of": np.arange(1, width + 1, dtype=np.float32),
        "left_of": np.arange(width, 0, -1, dtype=np.float32),
        "below": np.arange(1, height + 1, dtype=np.float32),
        "above": np.arange(height, 0, -1, dtype=np.float32),
        "width": np.full((1, 1, 1), width, np.float32),
        "height": np.full((1, 1, 1), height, np.float32),
    }
    nodes = [
        helper.make_node("Conv", ["images", "weights", "bias"], ["colour"], kernel_shape=[1, 1]),
        helper.make_node("Clip", ["colour", "low", "high"], ["mask"]),
        helper.make_node("ReduceMax", ["mask"], ["columns"], axes=[2], keepdims=0),
        helper.make_node("ReduceMax", ["mask"], ["rows"], axes=[3], keepdims=0),
        helper.make_node("ReduceMax", ["columns"], ["score"], axes=[2], keepdims=1),
        helper.make_node("Mul", ["score", "zero"], ["label"]),
    ]
    for edge, of, places in (
        ("right", "columns", "right_of"),
        ("from_right", "columns", "left_of"),
        ("bottom", "rows", "below"),
        ("from_bottom", "rows", "above"),
    ):
        nodes.append(helper.make_node("Mul", [of, places], [f"{edge}s"]))
        nodes.append(helper.make_node("ReduceMax", [f"{edge}s"], [edge], axes=[2], keepdims=1))
    nodes += [
        helper.make_node("Sub", ["width", "from_right"], ["left"]),
        helper.make_node("Sub", ["height", "from_bottom"], ["top"]),
        helper.make_node("Concat", ["left", "top", "right", "bottom", "score", "label"], ["output0"], axis=2),
    ]
    return save(path, nodes, constants, {"output0": [image[0], len(channels), 6]}, image=image, metadata=metadata)


def mean_network(path: Path, *, image: Sequence[int | str] = ("n", 3, 16, 8), blocks: int = 4) -> Path:
    """A network that describes an image by the mean colours of `blocks` stripes from top to bottom, less 0.5."""
    height, width = int(image[2]), int(image[3])
    nodes = [
        helper.make_node(
            "AveragePool", ["images"], ["means"], kernel_shape=[height // blocks, width], strides=[height // blocks, 1]
        ),
        helper.make_node("Add", ["means", "centre"], ["centred"]),
        helper.make_node("Reshape", ["centred", "flat"], ["vector"]),
    ]
    constants = {"centre": np.float32([[[[-0.5]]]]), "flat": np.array([0, 3 * blocks], np.int64)}
    return save(path, nodes, constants, {"vector": [image[0], 3 * blocks]}, image=image)


def costly_network(path: Path, side: int = 320, channels: int = 24, layers: int = 8) -> Path:
    """A network of convolutions (at 416 px 3.2 GFLOP), with the outputs of YOLOv8 of one class and no box."""
    rng = np.random.default_rng(0)
    nodes, constants = [], {}
    last, deep = "images", 3
    for k in range(layers):
        weights = rng.normal(0.0, (2.0 / (9 * deep)) ** 0.5, (channels, deep, 3, 3))
        constants[f"weights{k}"] = weights.astype(np.float32)
        step = 2 if k == 0 else 1
        nodes.append(
            helper.make_node(
                "Conv",
                [last, f"weights{k}"],
                [f"conv{k}"],
                kernel_shape=[3, 3],
                pads=[1, 1, 1, 1],
                strides=[step, step],
            )
        )
        nodes.append(helper.make_node("Relu", [f"conv{k}"], [f"relu{k}"]))
        last, deep = f"relu{k}", channels
    constants |= {"five": rng.normal(0, 0.01, (5, deep, 8, 8)).astype(np.float32), "low": np.float32(0)}
    constants |= {"high": np.float32(1), "flat": np.array([0, 5, -1], np.int64)}
    nodes += [
        helper.make_node("Conv", [last, "five"], ["coarse"], kernel_shape=[8, 8], strides=[8, 8]),
        helper.make_node("Clip", ["coarse", "low", "high"], ["cut"]),
        helper.make_node("Reshape", ["cut", "flat"], ["output0"]),
    ]
    return save(path, nodes, constants, {"output0": ["n", 5, None]}, image=("n", 3, side, side))
