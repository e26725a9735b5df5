"""Data files of the package (``synth/data``), and checks of names in them.

Cast: the bodies, clothes, suits, poses, furniture and rooms of synthetic people. Data of the judging cast are
in ``synth/data/judge``; no training and no tuning uses them.
"""

import tomllib
from collections.abc import Collection
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

from sensors.errors import CloudError

Cast = Literal["training", "judge"]
TRAINING: Cast = "training"
JUDGE: Cast = "judge"
CASTS: tuple[Cast, ...] = (TRAINING, JUDGE)


def shipped(*names: str) -> Path:
    """Return the path of a file or folder in ``synth/data``."""
    return Path(str(files("synth").joinpath("data", *names)))


@cache
def table(name: str) -> dict[str, Any]:
    """Return the content of ``synth/data/NAME.toml``; its comments state units and sources."""
    return tomllib.loads(shipped(f"{name}.toml").read_text(encoding="utf-8"))


def table_of(cast: Cast, name: str) -> dict[str, Any]:
    """Return the content of a cast's ``NAME.toml``."""
    return table(f"judge/{name}" if cast == JUDGE else name)


def check_choice(kind: str, name: str, known: Collection[str]) -> None:
    """Raise CloudError, listing the known names, for an unknown name."""
    if name not in known:
        raise CloudError(f"{kind} {name!r} is unknown; use {', '.join(known)}")
