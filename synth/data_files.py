"""Data files that come with the package: ``synth/data``."""

import tomllib
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any


def shipped(*names: str) -> Path:
    """Path of a file or folder in ``synth/data``."""
    return Path(str(files("synth").joinpath("data", *names)))


@cache
def table(name: str) -> dict[str, Any]:
    """Content of ``synth/data/NAME.toml``; its comments state units and sources."""
    return tomllib.loads(shipped(f"{name}.toml").read_text(encoding="utf-8"))
