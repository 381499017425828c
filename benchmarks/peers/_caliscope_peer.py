"""Poses of two cameras from matched points with caliscope; runs in an environment of its own.

`python _caliscope_peer.py GIVEN.npz`: GIVEN holds `matrix` (C, 3, 3), `distortion` (C, 5) and `size` (C, 2) of the
cameras, and `points` (N, 5) frame, camera, person, part of the body, u and v.  Prints JSON: world-to-camera rotations
and translations, converged, version.
"""

from __future__ import annotations

import json
import sys
from importlib.metadata import version

import numpy as np
import pandas as pd
from caliscope.api import CameraArray, CameraData, CaptureVolume, ImagePoints


def main() -> None:
    """Estimate poses from nothing, by epipolar geometry, then bundle adjustment."""
    given = np.load(sys.argv[1])
    cameras = {
        c: CameraData(cam_id=c, size=tuple(map(int, size)), matrix=matrix, distortions=distortion)
        for c, (size, matrix, distortion) in enumerate(
            zip(given["size"], given["matrix"], given["distortion"], strict=True)
        )
    }
    names = ["sync_index", "cam_id", "object_id", "keypoint_id", "img_loc_x", "img_loc_y"]
    points = pd.DataFrame(given["points"], columns=names).astype(dict.fromkeys(names[:4], int))
    volume = CaptureVolume.bootstrap(ImagePoints(points), CameraArray(cameras)).optimize(strict=False, verbose=0)
    found = [volume.camera_array.cameras[c] for c in sorted(cameras)]
    status = volume.optimization_status
    print(
        json.dumps(
            {
                "rotation": [c.rotation.tolist() for c in found],
                "translation": [c.translation.ravel().tolist() for c in found],
                "converged": bool(status is not None and status.converged),
                "version": version("caliscope"),
            }
        )
    )


if __name__ == "__main__":
    main()
