"""One file a tracking method, built from core."""
