"""Settings that the window remembers: size, places of splitters, colourings, tool, order of frames."""

import json
import os
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar, get_args

from annotate.correction.correction import Correction
from annotate.gui.state.drawing import TOOLS, Tool
from annotate.gui.state.frame_order import ORDERS, Order
from annotate.gui.state.point_colors import TINTS, Colouring, Look
from sensors.errors import CloudError
from sensors.files.atomic import write_bytes
from sensors.files.bounded import read_bounded

V = TypeVar("V")

MAX_BYTES = 100_000
"""Largest file that is read, in bytes."""
MOST_SETS = 50
"""Number of label sets whose orders and recordings are stored: some ten kilobytes (untuned)."""
SIDES = (200, 20_000)
"""Least and greatest side of a remembered window or pane, in logical pixels."""


@dataclass
class Memory:
    """Settings of the last window. path: file for them, None for nowhere.

    size: of the window in logical pixels. theme: "light", "dark", or "" for the setting's. looks: of the
    cloud and of the depth image. splits: sizes of the two splitters' panes, () for those of a new window.
    orders: of the frames, by label set and person (``order_key``). sessions: recordings given with --session,
    by label set. Of both, the last MOST_SETS are kept.
    """

    size: tuple[int, int] = (1440, 900)
    maximized: bool = False
    swapped: bool = False
    theme: str = ""
    tool: Tool = "piece"
    radius_px: float = 18.0
    looks: tuple[Look, Look] = (Look(), Look("colour", tint=TINTS[1]))
    splits: tuple[tuple[int, ...], ...] = field(default=())
    orders: dict[str, Order] = field(default_factory=dict)
    sessions: dict[str, str] = field(default_factory=dict)
    path: Path | None = None

    def order(self, key: str) -> Order:
        """Return the order of the frames that a person had in a set."""
        return self.orders.get(key, "time")

    def with_order(self, key: str, order: Order) -> "Memory":
        """Return this memory with the order of a set's frames for a person."""
        return replace(self, orders=_with(self.orders, key, order))

    def with_session(self, labels: Path, session: Path) -> "Memory":
        """Return this memory with the recording of a label set."""
        return replace(self, sessions=_with(self.sessions, str(labels.resolve()), str(session.resolve())))

    def session(self, labels: Path) -> Path | None:
        """Return the recording that was given for a label set, where it is still there."""
        known = self.sessions.get(str(labels.resolve()))
        return Path(known) if known and Path(known).exists() else None


def order_key(correction: Correction) -> str:
    """Return the name under which a person's order of a set's frames is remembered."""
    return f"{correction.labels.path.resolve()} {correction.who}"


def _with(known: dict[str, V], key: str, value: V) -> dict[str, V]:
    """Return a dictionary with an entry at the end, and only its last MOST_SETS."""
    entries = {name: old for name, old in known.items() if name != key} | {key: value}
    return dict(list(entries.items())[-MOST_SETS:])


def memory_path() -> Path:
    """window.json in the user's folder for states (XDG Base Directory Specification 0.8)."""
    home = os.environ.get("XDG_STATE_HOME") or "~/.local/state"
    return (Path(home) / "annotate-cloud" / "window.json").expanduser()


def recall(path: Path | None) -> Memory:
    """Settings as remembered; missing or invalid ones are as in a new window."""
    memory = Memory(path=path)
    if path is None:
        return memory
    try:
        known = json.loads(read_bounded(path, MAX_BYTES))
    except (CloudError, ValueError, RecursionError):
        return memory
    for name, value in known.items() if isinstance(known, dict) else ():
        with suppress(TypeError, ValueError, KeyError, AttributeError):
            _take(memory, name, value)
    return memory


def remember(memory: Memory) -> None:
    """Write settings to their file; ignore a disk that refuses."""
    if memory.path is not None:
        fields = {name: value for name, value in asdict(memory).items() if name != "path"}
        with suppress(OSError):
            memory.path.parent.mkdir(parents=True, exist_ok=True)
            write_bytes(memory.path, json.dumps(fields).encode())


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
    elif name == "orders":
        memory.orders = {str(key): order for key, order in value.items() if order in ORDERS}
    elif name == "sessions":
        memory.sessions = {str(key): path for key, path in value.items() if isinstance(path, str)}
    else:
        known = {"theme": ("light", "dark"), "tool": TOOLS}[name]
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
