"""Lengths of time that options give."""

import math

from typer import BadParameter

LONGEST = 1e6  # minutes or seconds; a longer time is a mistake


def duration(value: float | None) -> float | None:
    """Return a length of time, seconds or minutes. Raises BadParameter for nan and more than ``LONGEST``."""
    if value is not None and (math.isnan(value) or value > LONGEST):
        raise BadParameter(f"{value} is not a length of time; give at most {LONGEST:.0f}")
    return value
