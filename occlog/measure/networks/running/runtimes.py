"""Inference runtimes: OpenCV (always available), ONNX Runtime and OpenVINO (extras)."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import ModuleType
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from occlog.errors import InputError, UsageError
from occlog.io.files.names import utf8_name
from occlog.io.formats.models.onnx_file import OnnxFile

from ..config import ONNXRUNTIME, OPENCV, OPENVINO
from .messages import Feeds


class Runtime(Protocol):
    """Interface of a network that is loaded in an inference runtime."""

    @property
    def called(self) -> str:
        """Name and version of the runtime."""

    def run(self, feeds: Feeds) -> dict[str, NDArray[np.generic]]:
        """Outputs by name; InputError on failure."""


def load(model: OnnxFile, runtime: str, threads: int) -> Runtime:
    """Load a network in an inference runtime.

    Args:
        model: description of the ONNX file.
        runtime: `opencv`, `onnxruntime` or `openvino`.
        threads: number of threads that the network may use; OpenCV takes those of `opencv_threads`.

    Raises:
        InputError: the runtime cannot load it.
        UsageError: the runtime is not installed.
    """
    if runtime == OPENCV:
        return _OpenCv(model)
    return _OnnxRuntime(model, threads) if runtime == ONNXRUNTIME else _OpenVino(model, threads)


@contextmanager
def opencv_threads(threads: int) -> Iterator[None]:
    """Context manager: set the number of OpenCV threads, and silence its messages; both are restored at the end."""
    log = cv2.utils.logging
    before, level = cv2.getNumThreads(), log.getLogLevel()
    cv2.setNumThreads(threads)
    log.setLogLevel(log.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.setNumThreads(before)
        log.setLogLevel(level)


def _extra(name: str) -> ModuleType:
    """Import the Python module of an optional runtime; UsageError if it is not installed."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise UsageError(
            f"runtime {name}: is not installed ({error}); run: pip install {name}, or take another runtime",
            id="missing-package",
        ) from None


@contextmanager
def _as_input_error(model: OnnxFile, called: str, errors: tuple[type[Exception], ...], does: str) -> Iterator[None]:
    """Context manager that converts errors of a runtime to InputError.

    Args:
        model: description of the network's file.
        called: name of the runtime, for the message.
        errors: exception types that are converted.
        does: verb for the message: what the runtime cannot do with the network.
    """
    try:
        yield
    except errors as error:
        reason = " ".join(str(error).split())[:200]
        raise InputError(
            f"{model.path}: {called} cannot {does} this network ({reason}); another runtime may, or export it again",
            id="unsupported-network",
        ) from None


@dataclass
class _OpenCv:
    """Network in the runtime `cv2.dnn`."""

    model: OnnxFile

    ERRORS = (cv2.error, SystemError, MemoryError)

    def __post_init__(self) -> None:
        if any(port.kind == "float16" for port in self.model.inputs):
            raise InputError(f"{self.model.path}: requires numbers of 16 bits, which {self.called} does not take; use "
                             f"the runtime {ONNXRUNTIME}", id="unsupported-network")  # fmt: skip
        with _as_input_error(self.model, self.called, self.ERRORS, "load"), utf8_name(self.model.path) as name:
            self.net = cv2.dnn.readNetFromONNX(name)

    @property
    def called(self) -> str:
        return f"{OPENCV} {cv2.__version__}"

    def run(self, feeds: Feeds) -> dict[str, NDArray[np.generic]]:
        names = [port.name for port in self.model.outputs]
        with _as_input_error(self.model, self.called, self.ERRORS, "run"):
            for name, values in feeds.items():
                self.net.setInput(values, name)
            found = self.net.forward(names)
        return dict(zip(names, map(np.asarray, found), strict=True))


@dataclass
class _OnnxRuntime:
    """Network in the runtime `onnxruntime`, on the CPU."""

    model: OnnxFile
    threads: int

    ERRORS = (Exception,)  # they have no common base class

    def __post_init__(self) -> None:
        self.module: Any = _extra(ONNXRUNTIME)
        options = self.module.SessionOptions()
        options.intra_op_num_threads, options.inter_op_num_threads = self.threads, 1
        options.use_deterministic_compute = True
        options.log_severity_level = 4
        with _as_input_error(self.model, self.called, self.ERRORS, "load"), utf8_name(self.model.path) as name:
            self.session = self.module.InferenceSession(name, options, providers=["CPUExecutionProvider"])

    @property
    def called(self) -> str:
        return f"{ONNXRUNTIME} {self.module.__version__}"

    def run(self, feeds: Feeds) -> dict[str, NDArray[np.generic]]:
        names = [port.name for port in self.model.outputs]
        with _as_input_error(self.model, self.called, self.ERRORS, "run"):
            found = self.session.run(names, dict(feeds))
        return dict(zip(names, map(np.asarray, found), strict=True))


@dataclass
class _OpenVino:
    """Runtime `openvino` on the CPU, in float32."""

    model: OnnxFile
    threads: int

    ERRORS = (Exception,)  # they have no common base class

    def __post_init__(self) -> None:
        self.module: Any = _extra(OPENVINO)
        config = {"INFERENCE_NUM_THREADS": self.threads, "INFERENCE_PRECISION_HINT": "f32", "NUM_STREAMS": 1}
        with _as_input_error(self.model, self.called, self.ERRORS, "load"):
            core = self.module.Core()
            self.compiled = core.compile_model(core.read_model(str(self.model.path)), "CPU", config)

    @property
    def called(self) -> str:
        return f"{OPENVINO} {self.module.__version__.split('-')[0]}"

    def run(self, feeds: Feeds) -> dict[str, NDArray[np.generic]]:
        names = [port.name for port in self.model.outputs]
        with _as_input_error(self.model, self.called, self.ERRORS, "run"):
            found = self.compiled(dict(feeds))
            return {name: np.array(found[name]) for name in names}
