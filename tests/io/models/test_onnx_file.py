from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from small_networks import constant_network, helper, numpy_helper, onnx, save

from occlog.errors import InputError
from occlog.io.formats.models.onnx_file import DEEPEST, Port, read_onnx


def network(folder: Path) -> Path:
    values = {"output0": np.zeros((1, 5, 84), np.float32)}
    return constant_network(folder / "a.onnx", values, image=("n", 3, 64, "w"), metadata={"names": "{0: 'owl'}"})


def outside(folder: Path, location: str, where: str = "graph") -> Path:
    """A network whose weights are in another file."""
    model = onnx.load(network(folder))
    tensor = onnx.TensorProto(name="weights", data_type=onnx.TensorProto.FLOAT, dims=[2], data_location=1)
    tensor.external_data.add(key="location", value=location)
    if where == "graph":
        model.graph.initializer.append(tensor)
    elif where == "attribute":
        model.graph.node[0].attribute.append(helper.make_attribute("value", tensor))
    elif where == "inner graph":
        inner = helper.make_graph([], "inner", [], [], [tensor])
        model.graph.node[0].attribute.append(helper.make_attribute("then_branch", inner))
    else:
        node = helper.make_node("Constant", [], ["c"])
        node.attribute.append(helper.make_attribute("value", tensor))
        model.functions.append(helper.make_function("d", "f", [], ["c"], [node], [helper.make_opsetid("", 13)]))
    (folder / "b.onnx").write_bytes(model.SerializeToString())
    return folder / "b.onnx"


def test_inputs_outputs_and_metadata_are_those_that_the_onnx_package_sees(tmp_path: Path) -> None:
    found = read_onnx(network(tmp_path))
    assert found.inputs == (Port("images", "float32", (None, 3, 64, None)),)
    assert found.outputs == (Port("output0", "float32", (None, 5, 84)),)
    assert found.metadata == {"names": "{0: 'owl'}"}
    assert found.files == (tmp_path / "a.onnx",)


def test_inputs_that_have_a_value_in_the_file_are_none(tmp_path: Path) -> None:
    model = onnx.load(network(tmp_path))
    model.graph.input.append(helper.make_tensor_value_info("zero", onnx.TensorProto.FLOAT, [1]))
    (tmp_path / "b.onnx").write_bytes(model.SerializeToString())
    assert [port.name for port in read_onnx(tmp_path / "b.onnx").inputs] == ["images"]


def test_weights_in_the_folder_are_files_of_the_network(tmp_path: Path) -> None:
    (tmp_path / "w.bin").write_bytes(b"12345678")
    assert read_onnx(outside(tmp_path, "w.bin")).weights == (tmp_path / "w.bin",)


@pytest.mark.parametrize("where", ["graph", "attribute", "inner graph", "function"])
@pytest.mark.parametrize("location", ["../w.bin", "{}/w.bin", "link.bin", "a/../../w.bin", "w\0.bin"])
def test_weights_outside_of_the_folder_are_refused_wherever_they_are_named(
    tmp_path: Path, location: str, where: str
) -> None:
    folder = tmp_path / "model"
    folder.mkdir()
    (tmp_path / "w.bin").write_bytes(b"12345678")
    (folder / "link.bin").symlink_to(tmp_path / "w.bin")
    with pytest.raises(InputError, match="outside the model's folder"):
        read_onnx(outside(folder, location.format(tmp_path), where))


def test_weights_that_are_not_there_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"w\.bin: no such file; weights of b\.onnx"):
        read_onnx(outside(tmp_path, "w.bin"))


def test_a_file_that_ends_early_is_refused_or_says_less(tmp_path: Path) -> None:
    whole = network(tmp_path).read_bytes()
    path = tmp_path / "cut.onnx"
    for size in range(1, len(whole), 7):
        path.write_bytes(whole[:size])
        try:
            assert read_onnx(path).outputs
        except InputError as error:
            assert str(path) in str(error)


@pytest.mark.parametrize(
    "data", [b"\xff" * 100, b"PK\x03\x04" + b"x" * 50, b"hello, world", b"\x3a\x80\x80\x80\x80\x10"]
)
def test_other_files_are_no_network(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "x.onnx").write_bytes(data)
    with pytest.raises(InputError, match="not an ONNX model"):
        read_onnx(tmp_path / "x.onnx")


def test_bytes_that_were_changed_give_a_network_or_one_error(tmp_path: Path) -> None:
    whole, rng = network(tmp_path).read_bytes(), np.random.default_rng(0)
    path = tmp_path / "changed.onnx"
    for _ in range(300):
        data = bytearray(whole)
        for place in rng.integers(0, len(data), 3):
            data[place] = rng.integers(0, 256)
        path.write_bytes(data)
        try:
            read_onnx(path)
        except InputError as error:
            assert "\n" not in str(error)


def test_graphs_too_deep_in_graphs_are_refused(tmp_path: Path) -> None:
    inner = helper.make_graph([], "inner", [], [], [numpy_helper.from_array(np.zeros(1, np.float32), "w")])
    for depth in range(DEEPEST + 2):
        node = helper.make_node("If", ["c"], ["o"])
        node.attribute.append(helper.make_attribute("then_branch", inner))
        inner = helper.make_graph([node], f"g{depth}", [], [])
    model = onnx.load(network(tmp_path))
    model.graph.node.append(inner.node[0])
    (tmp_path / "deep.onnx").write_bytes(model.SerializeToString())
    with pytest.raises(InputError, match="deep"):
        read_onnx(tmp_path / "deep.onnx")


WEIGHTS = {
    "beyond": ([2**31, 2**31], np.zeros(4, np.float32), "have a dimension of"),
    "negative": ([-1, 3], np.zeros(4, np.float32), "have a dimension of"),
    "few": ([1, 3, 64, 64], np.zeros(4, np.float32), "have 4 values, but a shape of 12288"),
    "many": ([1], np.zeros(4, np.float32), "have 4 values, but a shape of 1 values"),
}


@pytest.mark.parametrize("typed", [False, True])
@pytest.mark.parametrize("case", WEIGHTS)
def test_weights_are_as_many_as_their_dimensions_say(tmp_path: Path, case: str, typed: bool) -> None:
    """OpenCV read what lies behind them in memory, or ended the process."""
    sides, values, reported = WEIGHTS[case]
    tensor = onnx.TensorProto(name="w", dims=sides, data_type=1)
    if typed:
        tensor.float_data.extend(values.tolist())
    else:
        tensor.raw_data = values.tobytes()
    path = save(tmp_path / "m.onnx", [helper.make_node("Add", ["images", "w"], ["o"])], {}, {"o": [1, 3, 64, 64]})
    model = onnx.load(path)
    model.graph.initializer.append(tensor)
    path.write_bytes(model.SerializeToString())
    with pytest.raises(InputError, match=reported):
        read_onnx(path)


@pytest.mark.parametrize(("name", "value"), [("strides", [0, 0]), ("kernel_shape", [1, -1]), ("group", 0)])
def test_attributes_by_which_runtimes_divide_are_above_zero(tmp_path: Path, name: str, value: object) -> None:
    """Strides of 0 ended the process with a floating point exception of OpenCV."""
    node = helper.make_node("Conv", ["images", "w"], ["o"], **{name: value})
    path = save(tmp_path / "m.onnx", [node], {"w": np.ones((1, 3, 1, 1), np.float32)}, {"o": [1, 1, 64, 64]})
    with pytest.raises(InputError, match=f"{name} of 0 or less"):
        read_onnx(path)
