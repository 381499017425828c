"""`occlog report`: show a run as an offline page, a picture, or video with tracks drawn in."""
