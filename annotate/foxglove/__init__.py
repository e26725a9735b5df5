"""Labelled frames for Foxglove: as messages, as a file, as a stream."""
