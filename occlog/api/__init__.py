"""Functions of occlog for Python: what the commands do, on values and files, with the same names and defaults."""

from occlog.errors import InputError, OcclogError, OutputError, OutputExistsError, PluginError, UsageError
from occlog.records.losses import Loss
from occlog.records.scene import Scene
from occlog.settings import SettingError

from .recordings import Recording, Sensor, open, read, read_scene
from .results import DetectResult, EvaluateResult, OcclogWarning, OverlayResult, ReportResult, Result, TrackResult
from .stages import detect, evaluate, fuse, fuse_tracks, ingest, label, overlay, report, simulate, track
from .tables import Table

__all__ = [
    "DetectResult",
    "EvaluateResult",
    "InputError",
    "Loss",
    "OcclogError",
    "OcclogWarning",
    "OutputError",
    "OutputExistsError",
    "OverlayResult",
    "PluginError",
    "Recording",
    "ReportResult",
    "Result",
    "Scene",
    "Sensor",
    "SettingError",
    "Table",
    "TrackResult",
    "UsageError",
    "detect",
    "evaluate",
    "fuse",
    "fuse_tracks",
    "ingest",
    "label",
    "open",
    "overlay",
    "read",
    "read_scene",
    "report",
    "simulate",
    "track",
]
