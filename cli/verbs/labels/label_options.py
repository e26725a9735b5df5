"""Options that ``label`` and ``predict`` share."""

import math
from pathlib import Path
from typing import Annotated

import typer
from typer import Option


def _window(window_c: tuple[float, float] | None) -> tuple[float, float] | None:
    if window_c is None:
        return None
    low, high = window_c
    if not -math.inf < low < high < math.inf:
        raise typer.BadParameter(f"{low} to {high} is not a range; give the lower temperature first")
    return window_c


Window = Annotated[
    tuple[float, float] | None,
    Option(
        help="Lowest and highest temperature of a person, degrees Celsius. Default: found in each frame.",
        callback=_window,
    ),
]
Labels = Annotated[Path, Option(help="Label set to write; an interrupted run continues there.")]
