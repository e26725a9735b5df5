"""Panels around the views: bars, frames, parts, progress, hints."""
