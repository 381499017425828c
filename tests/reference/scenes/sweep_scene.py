"""A small scene and trials for the sweep's tests."""

SCENE = """\
occlog_scene: 1
length_unit: unit
room: [[0, 0], [100, 0], [100, 100], [0, 100]]
cameras:
- {name: a, position: [0, 0], yaw_deg: 45, focal_px: 70, fov_deg: 90, noise: {position: 1, yaw: 0.01,
measurement_noise_px: 2}}
- {name: b, position: [100, 0], yaw_deg: 135, focal_px: 70, fov_deg: 90, noise: {position: 1, yaw: 0.01,
measurement_noise_px: 2}}
- {name: c, position: [0, 100], yaw_deg: 315, focal_px: 70, fov_deg: 90, noise: {position: 1, yaw: 0.01,
measurement_noise_px: 2}}
"""


def trial(run=0, **changes):
    """Ten steps among five occluders."""
    base = {
        "scene": SCENE,
        "seed": 3,
        "run": run,
        "simulate": {"steps": 10, "occluders": 5},
        "track": {"particles": 100},
    }
    return {**base, **changes}


def without_times(results):
    """What must not differ between runs."""
    return [{k: v for k, v in r.items() if k != "track_seconds"} for r in results]
