"""occlog: recorded multi-camera video and acoustic logs to evaluated tracks."""

__version__ = "0.1.0"
