"""Labelled frames for Foxglove: messages, file, stream."""
