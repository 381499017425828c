"""Method `jipda`: multi-camera JIPDA tracking of all people on the ground plane, with mutual occlusion."""
