"""Verb: remove false detections and recover missed ones, from several cameras."""
