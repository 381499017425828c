"""How good bearings, azimuths and detections are."""
