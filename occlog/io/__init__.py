"""Conversion of file formats to records and back; `open.py` opens inputs."""
