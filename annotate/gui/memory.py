"""Settings that the window remembers: size, places of splitters, colourings, tool, order of frames."""

import json
import os
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, get_args

from annotate.gui.colors import TINTS, Colouring, Look
from annotate.gui.drawing import TOOLS, Tool
from annotate.gui.walk import ORDERS, Order
from sensors.errors import CloudError
from sensors.files.atomic import write_bytes
from sensors.files.bounded import read_bounded

MAX_BYTES = 100_000
"""Largest file that is read, in bytes."""
SIDES = (200, 20_000)
"""Least and greatest side of a remembered window or pane, in logical pixels."""


@dataclass
class Memory:
    """size: of the window in logical pixels. theme: "light", "dark", or "" for the setting's. looks: of the
    cloud and of the depth image. splits: sizes of the two splitters' panes, () for those of a new window."""

    size: tuple[int, int] = (1440, 900)
    maximized: bool = False
    swapped: bool = False
    theme: str = ""
    order: Order = "time"
    tool: Tool = "piece"
    radius_px: float = 18.0
    looks: tuple[Look, Look] = (Look(), Look("colour", tint=TINTS[1]))
    splits: tuple[tuple[int, ...], ...] = field(default=())


def memory_path() -> Path:
    """window.json in the user's folder for states (XDG Base Directory Specification 0.8)."""
    home = os.environ.get("XDG_STATE_HOME") or "~/.local/state"
    return (Path(home) / "annotate-cloud" / "window.json").expanduser()


def recall(path: Path | None) -> Memory:
    """Settings as remembered; missing or invalid ones are as in a new window."""
    memory = Memory()
    if path is None:
        return memory
    try:
        known = json.loads(read_bounded(path, MAX_BYTES))
    except (CloudError, ValueError, RecursionError):
        return memory
    for name, value in known.items() if isinstance(known, dict) else ():
        with suppress(TypeError, ValueError, KeyError):
            _take(memory, name, value)
    return memory


def remember(path: Path | None, memory: Memory) -> None:
    """Write it down; a disk that refuses costs the memory and nothing else."""
    if path is not None:
        with suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            write_bytes(path, json.dumps(asdict(memory)).encode())


def _take(memory: Memory, name: str, value: Any) -> None:  # noqa: ANN401  (whatever the file holds)
    if name in ("maximized", "swapped"):
        setattr(memory, name, value is True)
    elif name == "size":
        width, height = map(_side, value)
        memory.size = width, height
    elif name == "splits":
        memory.splits = tuple(tuple(_side(size, least=0) for size in sizes) for sizes in value[:2])
    elif name == "radius_px":
        memory.radius_px = float(value)
    elif name == "looks":
        cloud, depth = (_look(**look) for look in value)
        memory.looks = cloud, depth
    else:
        known = {"theme": ("light", "dark"), "order": tuple(ORDERS), "tool": TOOLS}[name]
        if value in known:
            setattr(memory, name, value)


def _side(value: object, least: int = SIDES[0]) -> int:
    if type(value) is not int or not least <= value <= SIDES[1]:
        raise ValueError
    return value


def _look(colouring: Colouring, outlines: bool, tint: float) -> Look:
    if colouring not in get_args(Colouring) or tint not in TINTS:
        raise ValueError
    return Look(colouring, outlines is True, tint)
