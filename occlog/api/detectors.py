"""Detectors other than the background, in Python: networks (ONNX) and plug-ins, which find boxes."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from occlog.errors import UsageError
from occlog.measure.detect.config import DetectConfig
from occlog.measure.networks.config import NetworkConfig

from .folders import Folder
from .keywords import Setting, settings_by_class

if TYPE_CHECKING:
    from occlog.plugins.chosen import Chosen
    from occlog.records.losses import Loss

NETWORK, PLUGIN = "with a network", "by a plug-in"


@dataclass(frozen=True)
class Network:
    """Files of a network that detects, and what it looks for; the arguments of `detect`."""

    onnx: str | os.PathLike[str] | None
    classes: Sequence[str]
    names: str | os.PathLike[str] | None
    embed: str | os.PathLike[str] | None

    @property
    def beside(self) -> list[str]:
        """Names of the arguments that were given beside the network itself."""
        return [name for name in ("classes", "names", "embed") if getattr(self, name)]


@dataclass(frozen=True)
class Where:
    """In what to detect, and where the tables go.

    Attributes:
        recording: with images.
        scene: where the cameras are; None: the recording holds it.
        only: names of cameras; empty: all.
        home: folder of the tables.
        bearings: a candidate bearing for each box is wanted.
    """

    recording: Path
    scene: Path | None
    only: tuple[str, ...]
    home: Folder
    bearings: bool

    @property
    def outputs(self) -> tuple[Path, Path | None]:
        """Files of views and bearings; None: these are not wanted."""
        return self.home.file("views.parquet"), self.home.file("bearings.parquet") if self.bearings else None


Detector: TypeAlias = "Network | Chosen"


def detector_of(
    network: Network, bearings: bool, settings: Mapping[str, Setting], of_background: Collection[str]
) -> Detector | None:
    """What detects instead of the background; None: nothing does.

    Args:
        network: arguments of networks.
        bearings: they are wanted beside views.
        settings: keywords; `method` may name a plug-in.
        of_background: names of the arguments given that only detection by the background has.

    Raises:
        UsageError: arguments or settings that do not go together, or no detector of that name.
    """
    from occlog.measure.detect.command import WITH_NETWORKS

    method = settings.get("method")
    found = network if network.onnx is not None else _plugged(method)
    by = PLUGIN if network.onnx is None else NETWORK
    if found is None or by == PLUGIN:
        of_network = {f.name for f in fields(NetworkConfig)} - _own(found)
        for name in (*network.beside, *(n for n in settings if n in of_network)):
            raise UsageError(f"{name} is for detection with a network; give onnx")
    if found is None and bearings:
        raise UsageError("bearings is for detection with a network or by a plug-in; give onnx, or its name as method")
    if found is not None:
        taken = {*WITH_NETWORKS, *_own(found), *(["method"] if by == PLUGIN else [])}
        theirs = {f.name for f in fields(DetectConfig)} - taken
        for name in (*of_background, *(n for n in settings if n in theirs)):
            raise UsageError(f"{name} is not for detection {by}; leave it out")
    return found


def run_detector(
    detector: Detector, where: Where, settings: Mapping[str, Setting], threads: int, progress: bool
) -> tuple[Mapping[str, Any], Sequence[Loss]]:
    """Detect with a network or a plug-in; the summary, and what was lost."""
    if not isinstance(detector, Network):
        return _by_plugin(detector, where, settings, progress)
    from occlog.measure.detect.run_network import NetworkRequest, run_network

    assert detector.onnx is not None
    of_boxes, of_network = settings_by_class("detect", settings, [("", DetectConfig), ("", NetworkConfig)], ())
    request = NetworkRequest(
        recording=where.recording,
        scene=where.scene,
        only=where.only,
        model=Path(detector.onnx),
        classes=tuple(str(name) for name in detector.classes),
        names=None if detector.names is None else Path(detector.names),
        embed=None if detector.embed is None else Path(detector.embed),
        settings=of_boxes,
        network=of_network,
        threads=threads,
    )
    return run_network(request, *where.outputs, False, not progress)


def _by_plugin(
    chosen: Chosen, where: Where, settings: Mapping[str, Setting], progress: bool
) -> tuple[Mapping[str, Any], Sequence[Loss]]:
    from occlog.measure.detect.run_plugin import PluginRequest, run_plugin

    rest = {name: value for name, value in settings.items() if name != "method"}
    classes = [("", DetectConfig), ("", chosen.plugin.load().settings)]
    shared, values = settings_by_class(chosen.plugin.name, rest, classes, ())
    of_boxes = {name: value for name, value in shared.items() if name not in _own(chosen)}
    request = PluginRequest(where.recording, where.scene, where.only, chosen._replace(values=values), of_boxes)
    return run_plugin(request, *where.outputs, False, not progress)


def _plugged(method: Setting) -> Chosen | None:
    """The plug-in of that name; None: the method is one of ours, or not given."""
    from occlog.cli.plugged import wanted
    from occlog.measure.detect.command import METHODS
    from occlog.plugins.chosen import Chosen
    from occlog.plugins.loading import DETECTOR

    if not isinstance(method, str) or method in METHODS:
        return None
    return Chosen(wanted(method, DETECTOR, "method", METHODS), {})


def _own(found: Detector | None) -> set[str]:
    """Names of a plug-in's own settings, which come before those of detection."""
    if found is None or isinstance(found, Network):
        return set()
    return {f.name for f in fields(found.plugin.load().settings)}
