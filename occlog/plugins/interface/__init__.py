"""What plug-ins implement: classes with a line of summary, a class of settings, and one function that works."""

from occlog.records.scene import Scene
from occlog.records.tables import Errors, Tracks, Truth
from occlog.settings import Settings, setting

from .detectors import Detected, Detector, Image
from .exporters import Exporter, World
from .filters import Filter, Moment, Place
from .metrics import Compared, Metric
from .readers import Columns, Reader
from .view_trackers import BoxesInFrame, ViewTracker

__all__ = [
    "BoxesInFrame",
    "Columns",
    "Compared",
    "Detected",
    "Detector",
    "Errors",
    "Exporter",
    "Filter",
    "Image",
    "Metric",
    "Moment",
    "Place",
    "Reader",
    "Scene",
    "Settings",
    "Tracks",
    "Truth",
    "ViewTracker",
    "World",
    "setting",
]
"""Everything that a plug-in needs of this program."""
