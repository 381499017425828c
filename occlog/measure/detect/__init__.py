"""`occlog detect`: reduce the frames of a recording to views and bearings."""
