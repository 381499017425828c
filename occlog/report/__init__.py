"""Verb: show a run as one offline page, a picture, or video with tracks drawn in."""
