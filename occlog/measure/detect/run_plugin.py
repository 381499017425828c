"""What `occlog detect --method` does: open a recording, detect in it with a plug-in, write views and bearings."""

from __future__ import annotations

from occlog.plugins.chosen import Chosen
from occlog.plugins.loading import DETECTOR, find
from occlog.records.losses import Loss
from occlog.runner import Job
from occlog.settings import configure

from .by_plugin import detect_by_plugin
from .config import DetectConfig
from .left_out import LeftOut
from .request import PluginRequest
from .run import frames_of, images_of, write_detections
from .run_network import figures, of_boxes


def run_plugin(request: PluginRequest, job: Job) -> tuple[dict[str, object], list[Loss]]:
    """Detect and write; the summary, and the input that was lost."""
    plugin = find(request.method, DETECTOR)
    assert plugin is not None  # its settings are those of the request
    chosen = Chosen(plugin, request.own)
    opened, scene, sensors = images_of(request, "a detector")
    config = configure(DetectConfig(), request.settings)
    parameters = {
        "cameras": list(request.cameras),
        "input": "images",
        "detector": chosen.provenance(scene.length_unit),
        **of_boxes(config),
        "min_confidence": config.min_confidence,
    }
    left = LeftOut()
    frames = left.watch(job.progress(opened.frames(sensors), "detect", frames_of(opened, sensors)))
    parts = detect_by_plugin(frames, scene, chosen, config)
    losses, tally = write_detections(job, parts, parameters, opened.losses, left, scene)
    return figures(request, tally, method=plugin.name, plugin=plugin.origin), losses
