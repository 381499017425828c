from __future__ import annotations

import importlib.util
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from small_networks import colour_network, constant_network, helper, mean_network, onnx, save

from occlog.errors import InputError, UsageError
from occlog.measure.networks.config import NetworkConfig
from occlog.measure.networks.detector import Boxed, NetworkDetector, open_detector, open_embedder
from occlog.measure.networks.network import size_of, tile_edges, tiles_of

THERE = [each for each in ("opencv", "onnxruntime", "openvino") if each == "opencv" or importlib.util.find_spec(each)]
PLACES = 84  # of an image of 64 x 64


def opened(path: Path, least: float = 0.5, classes: tuple[str, ...] = (), **settings: object) -> NetworkDetector:
    return open_detector(path, NetworkConfig(**settings), classes, None, least, 1)  # type: ignore[arg-type]


def find(detector: NetworkDetector, *images: np.ndarray) -> list[Boxed]:
    found = detector.find([detector.prepare(image) for image in images])
    assert None not in found
    return [each for each in found if each is not None]


def picture(size: tuple[int, int], block: tuple[int, int, int, int]) -> np.ndarray:
    """A grey image with a block (left, top, right, bottom) in red."""
    image = np.full((size[1], size[0], 3), 90, np.uint8)
    image[block[1] : block[3], block[0] : block[2]] = (0, 0, 255)
    return image


@pytest.mark.parametrize(
    ("runtime", "fit"), [*((each, "letterbox") for each in THERE), ("opencv", "corner"), ("opencv", "stretch")]
)
def test_a_block_is_found_where_it_is_at_any_shape_of_image(tmp_path: Path, runtime: str, fit: str) -> None:
    path = colour_network(tmp_path / "red.onnx", image=(1, 3, 64, 96))
    detector = opened(path, head="yolo", nms_iou=1.0, resize_mode=fit, runtime=runtime)
    for size in ((96, 64), (200, 50), (101, 67)):
        block = (size[0] // 4, size[1] // 4, 3 * size[0] // 4, 3 * size[1] // 4)
        (found,) = find(detector, picture(size, block))
        assert (found.score > 0.99).all()
        around = np.concatenate([found.boxes[:, :2].min(axis=0), found.boxes[:, 2:].max(axis=0)])
        # Boxes are pixels of the network's image: no edge is off by much more than one of them.
        where = detector.prepare(picture(size, block)).tiles[0].where
        limit = 1e-9 + 1.25 * (size != (96, 64)) / np.array([where.x_scale, where.y_scale] * 2)
        assert (np.abs(around - (np.array(block) - 0.5)) <= limit).all(), (size, around)


@pytest.mark.parametrize("runtime", THERE)
def test_results_do_not_depend_on_how_many_images_are_taken_at_a_time(tmp_path: Path, runtime: str) -> None:
    path = colour_network(tmp_path / "red.onnx", image=("n", 3, 64, 64))
    images = [picture((80 + k, 60), (10 + k, 10, 30 + k, 20)) for k in range(5)]
    alone = opened(path, head="yolo", runtime=runtime)
    wanted = [find(alone, image)[0] for image in images]
    detector = opened(path, head="yolo", runtime=runtime, batch=3)
    found = [each for k in range(0, 5, 3) for each in find(detector, *images[k : k + 3])]
    for a, b in zip(found, wanted, strict=True):
        assert a.boxes.tobytes() == b.boxes.tobytes()
        assert a.score.tobytes() == b.score.tobytes()


def test_boxes_come_by_falling_area_cut_at_the_edges_without_those_outside(tmp_path: Path) -> None:
    out = np.zeros((1, 5, PLACES), np.float32)
    out[0, :, 0] = (32, 32, 10, 10, 0.9)
    out[0, :, 1] = (0, 32, 40, 20, 0.6)  # half of it is outside
    out[0, :, 2] = (33, 32, 10, 10, 0.8)  # covers the first
    out[0, :, 3] = (32, 4, 8, 6, 0.7)  # in the border above
    (found,) = find(opened(constant_network(tmp_path / "a.onnx", {"output0": out})), np.zeros((32, 64, 3), np.uint8))
    assert_allclose(found.boxes, [[-0.5, 5.5, 19.5, 25.5], [26.5, 10.5, 36.5, 20.5]])
    assert_allclose(found.score, [0.6, 0.9])


def test_numbers_that_are_not_finite_are_not_taken(tmp_path: Path) -> None:
    out = np.full((1, 5, PLACES), np.nan, np.float32)
    detector = opened(constant_network(tmp_path / "a.onnx", {"output0": out}))
    assert detector.find([detector.prepare(np.zeros((64, 64, 3), np.uint8))]) == [None]


def test_a_network_with_a_fixed_number_of_images_is_given_so_many(tmp_path: Path) -> None:
    path = colour_network(tmp_path / "red.onnx", image=(4, 3, 64, 64))
    assert len(find(opened(path, head="yolo"), picture((64, 64), (8, 8, 16, 16)))[0].boxes) == 64
    with pytest.raises(UsageError, match="takes 4 images at a time, not 3"):
        opened(path, head="yolo", batch=3)


def test_the_size_is_the_networks_or_has_to_be_given(tmp_path: Path) -> None:
    fixed = constant_network(tmp_path / "a.onnx", {"output0": np.zeros((1, 5, PLACES), np.float32)})
    with pytest.raises(UsageError, match="of 64 x 64 px only, not 96 x 32; leave the size out"):
        opened(fixed, size="96x32")
    model = onnx.load(fixed)
    for dim in model.graph.input[0].type.tensor_type.shape.dim[2:]:
        dim.dim_param = "side"
    model.metadata_props.add(key="task", value="detect")
    onnx.save(model, str(tmp_path / "open.onnx"))
    with pytest.raises(UsageError, match="leaves the size of its images open"):
        opened(tmp_path / "open.onnx")
    assert opened(tmp_path / "open.onnx", size="64").network.size == (64, 64)
    model.metadata_props.add(key="imgsz", value="[64, 64]")
    onnx.save(model, str(tmp_path / "said.onnx"))
    assert opened(tmp_path / "said.onnx").parameters()["size"] == "64x64"


@pytest.mark.parametrize("text", ["", "a", "0", "64x", "64x64x64", "9000", "-3"])
def test_a_size_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="size"):
        size_of(text, "size")


def test_sizes_are_width_and_height() -> None:
    assert (size_of("640", "size"), size_of("960x544", "size"), size_of(None, "size")) == ((640, 640), (960, 544), None)


def test_rtdetr_is_reported_the_size_of_its_own_images(tmp_path: Path) -> None:
    nodes = [
        helper.make_node("Cast", ["orig_target_sizes"], ["size"], to=1),
        helper.make_node("Concat", ["size", "size"], ["edges"], axis=1),
        helper.make_node("Unsqueeze", ["edges", "one"], ["whole"]),
        helper.make_node("Mul", ["whole", "shares"], ["boxes"]),
        helper.make_node("ReduceMean", ["images"], ["mean"], axes=[1, 2, 3], keepdims=0),
        helper.make_node("Reshape", ["mean", "flat"], ["means"]),
        helper.make_node("Mul", ["means", "zeros"], ["labels"]),
        helper.make_node("Add", ["labels", "sure"], ["scores"]),
    ]
    constants = {
        "one": np.array([1], np.int64),
        "flat": np.array([-1, 1], np.int64),
        "shares": np.float32([[[0.25, 0.5, 0.75, 1.0]]]),
        "zeros": np.zeros((1, 1), np.float32),
        "sure": np.full((1, 1), 0.75, np.float32),
    }
    shapes = {"labels": [1, 1], "boxes": [1, 1, 4], "scores": [1, 1]}
    path = save(tmp_path / "a.onnx", nodes, constants, shapes, image=(1, 3, 32, 64), extent=True)
    for runtime in THERE:
        detector = opened(path, runtime=runtime)
        assert (detector.reading.head, detector.names.source) == ("rtdetr", "COCO, assumed")
        (found,) = find(detector, np.zeros((100, 300, 3), np.uint8))
        assert_allclose(found.boxes, [[74.5, 49.5, 224.5, 99.5]])


def test_files_that_cannot_be_used_are_one_line(tmp_path: Path) -> None:
    strange = save(
        tmp_path / "strange.onnx",
        [helper.make_node("NoSuchThing", ["images"], ["output0"])],
        {},
        {"output0": [1, 5, PLACES]},
    )
    for runtime in THERE:
        with pytest.raises(InputError, match=r"strange\.onnx: .* cannot (load|run) this network") as caught:
            opened(strange, runtime=runtime)
        assert "\n" not in str(caught.value)
    grey = constant_network(
        tmp_path / "g.onnx", {"output0": np.zeros((1, 5, PLACES), np.float32)}, image=(1, 1, 64, 64)
    )
    with pytest.raises(InputError, match="three channels"):
        opened(grey)
    flat = constant_network(tmp_path / "f.onnx", {"output0": np.zeros((1, 7), np.float32)})
    with pytest.raises(InputError, match=r"f\.onnx: its outputs are of no head that is known: output0 1 x 7"):
        opened(flat)


def test_a_runtime_that_is_missing_names_its_package(tmp_path: Path) -> None:
    path = colour_network(tmp_path / "red.onnx")
    for runtime in {"onnxruntime", "openvino"} - set(THERE):
        with pytest.raises(UsageError, match=f"pip install {runtime}"):
            opened(path, head="yolo", runtime=runtime)


@pytest.mark.parametrize("runtime", THERE)
def test_vectors_are_of_length_1_and_of_what_is_in_the_boxes(tmp_path: Path, runtime: str) -> None:
    image = np.zeros((40, 40, 3), np.uint8)
    image[:, :20] = (0, 0, 255)
    boxes = np.array([[0.5, 0.5, 10.5, 30.5], [25.5, 0.5, 35.5, 30.5], [19.5, 0.5, 39.5, 30.5]])
    for shape in (("n", 3, 16, 8), (1, 3, 16, 8), (2, 3, 16, 8)):
        path = mean_network(tmp_path / "reid.onnx", image=shape)
        embedder = open_embedder(path, NetworkConfig(runtime=runtime, embed_pixel_scaling="unit"), 1)
        found = embedder.vectors(image, boxes)
        assert_allclose(np.linalg.norm(found, axis=1), 1.0, rtol=1e-6)
        assert_allclose(found[0] * 12**0.5, np.repeat([1.0, -1.0, -1.0], 4), rtol=1e-6)
        assert_allclose(found[1:] * 12**0.5, -1.0, rtol=1e-6)
        assert embedder.vectors(image, boxes[:0]).shape == (0, 12)


def test_a_network_without_a_vector_is_refused_and_a_vector_of_nothing_is_nan(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"its outputs are output0 1 x 5 x 84; one vector of 2"):
        open_embedder(constant_network(tmp_path / "a.onnx", {"output0": np.ones((1, 5, 84))}), NetworkConfig(), 1)
    nothing = open_embedder(constant_network(tmp_path / "b.onnx", {"v": np.zeros((1, 8))}), NetworkConfig(), 1)
    assert np.isnan(nothing.vectors(np.zeros((9, 9, 3), np.uint8), np.array([[0.0, 0.0, 5.0, 5.0]]))).all()


@pytest.mark.parametrize(("length", "count"), [(768, 1), (768, 2), (577, 3), (1920, 4), (7, 16)])
def test_tiles_cover_a_side_and_overlap(length: int, count: int) -> None:
    edges = tile_edges(length, count)
    assert len(edges) == count
    assert (edges[0][0], edges[-1][1]) == (0, length)
    sides = {last - first for first, last in edges}
    assert len(sides) == 1
    for (_, last), (first, _) in pairwise(edges):
        assert last - first >= 0.2 * sides.copy().pop() - 1.5


@pytest.mark.parametrize("text", ["2", "0x2", "axb", "17x1", "2x2x2"])
def test_tiles_that_are_none_are_refused(text: str) -> None:
    with pytest.raises(UsageError, match="tiles"):
        tiles_of(text)


def test_an_object_in_tiles_is_found_once_and_finer_than_in_the_whole_image(tmp_path: Path) -> None:
    """Positions are 24 px apart in the whole image, and 10 to 13 px in a tile."""
    path = colour_network(tmp_path / "red.onnx", image=(1, 3, 64, 96))
    whole = opened(path, head="yolo", nms_iou=0.3, resize_mode="letterbox")
    tiled = opened(path, head="yolo", nms_iou=0.3, resize_mode="letterbox", tiles="3x2")
    assert tiled.parameters()["tiles"] == "3x2"
    assert "tiles" not in whole.parameters()
    image = picture((288, 192), (60, 50, 84, 74))
    (rough,), (fine,) = find(whole, image), find(tiled, image)
    assert len(fine.boxes) >= len(rough.boxes) > 0
    inside = np.array([59.5, 49.5, 83.5, 73.5])
    assert (fine.boxes[:, :2] >= inside[:2] - 13).all()
    assert (fine.boxes[:, 2:] <= inside[2:] + 13).all()


def test_a_box_that_ends_at_a_seam_of_tiles_is_left_to_the_next_tile(tmp_path: Path) -> None:
    """The network gives a box that fills its image: of the tiles all are cut off, and the whole image's stays."""
    out = np.array([[[0.0, 0.0, 96.0, 64.0, 0.9, 0.0]]])
    path = constant_network(
        tmp_path / "all.onnx", {"output0": out}, image=(1, 3, 64, 96), metadata={"names": "{0: 'person'}"}
    )
    (found,) = find(opened(path, head="end2end", resize_mode="stretch", tiles="2x2"), picture((192, 128), (0, 0, 9, 9)))
    assert_allclose(found.boxes, [[-0.5, -0.5, 191.5, 127.5]])
