"""File formats to records and back; knows no algorithm. `open.py` opens inputs."""
