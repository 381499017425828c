"""Motion by waypoints, errors of poses, expected error of a set of cameras."""
