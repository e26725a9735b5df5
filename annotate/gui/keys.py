"""Every key of the window: its effect, its place, and how users change it.

All keys lie under the left hand while the right hand holds the mouse. The parts are laid out like a body
that faces you: head on top, its right arm on the left.

     1  2  3        right upper arm   head    left upper arm
     Q  W  E        right forearm     torso   left forearm
     A  S  D        right upper leg   hip     left upper leg
     Z  X  C        right lower leg   erase   left lower leg
"""

import os
from collections import Counter
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

from annotate.parts import PARTS
from sensors.errors import CloudError
from sensors.files.bounded import read_toml

MAX_TOML_BYTES = 100_000
"""Largest window.toml that is read, in bytes."""
THEMES = ("system", "light", "dark")

BODY_KEYS = "123QWEASDZXC"
BODY_GRID = ((4, 1, 3), (6, 2, 5), (9, 7, 8), (11, 0, 10))
"""Part ids as a body that faces you, and their keys row by row."""


@dataclass(frozen=True)
class Binding:
    """One action of a key. name: as in window.toml; key: in Qt's notation; description: for the F1 page."""

    name: str
    key: str
    group: str
    description: str


BINDINGS: tuple[Binding, ...] = (
    *(
        Binding(PARTS[i].name, key, "Parts", PARTS[i].title if i else "Background: erase")
        for i, key in zip(chain(*BODY_GRID), BODY_KEYS, strict=True)
    ),
    Binding("undefined", "Ctrl+X", "Choosing", "Undefined"),
    Binding("pick", "`", "Choosing", "Choose the part under the pointer"),
    Binding("only", "4", "Choosing", "Replace only the part where a stroke starts"),
    Binding("solo", "Ctrl+A", "Choosing", "Show only the chosen part, or all again"),
    Binding("piece", "F", "Tools", "Piece: click, click again to grow it"),
    Binding("lasso", "G", "Tools", "Lasso: draw round it"),
    Binding("polygon", "T", "Tools", "Polygon: double-click closes it"),
    Binding("rectangle", "R", "Tools", "Rectangle: drag"),
    Binding("brush", "B", "Tools", "Brush: drag over it"),
    Binding("small", "Ctrl+1", "Tools", "Small brush"),
    Binding("medium", "Ctrl+2", "Tools", "Medium brush"),
    Binding("large", "Ctrl+3", "Tools", "Large brush"),
    Binding("through", "Tab", "Tools", "Front only, or through the body"),
    Binding("room", "6", "Tools", "Body only, or the room too"),
    Binding("cancel", "Esc", "Tools", "Cancel the stroke or the preview"),
    Binding("undo", "Ctrl+Z", "Edit", "Undo, without limit"),
    Binding("redo", "Ctrl+Shift+Z", "Edit", "Redo"),
    Binding("swap", "V", "Edit", "Swap left and right of the limb under the pointer"),
    Binding("neighbour", "5", "Edit", "Give the patch under the pointer to its neighbour"),
    Binding("fill_holes", "Ctrl+F", "Edit", "Fill holes: press again to apply"),
    Binding("remove_islands", "Ctrl+D", "Edit", "Remove islands: press again to apply"),
    Binding("merge", "Ctrl+E", "Edit", "Turn the part under the pointer into the chosen one"),
    Binding("copy_previous", "Ctrl+V", "Edit", "Copy the parts of the previous frame"),
    Binding("propagate", "Ctrl+G", "Edit", "Carry over the corrections of nearby frames"),
    Binding("carry", "Ctrl+Shift+G", "Edit", "Do so in every frame that accepting opens"),
    Binding("accept", "Space", "Frames", "Accept the frame and go on"),
    Binding("reject", "Ctrl+R", "Frames", "Reject, with a reason"),
    Binding("next", "Ctrl+Space", "Frames", "Next frame, without a verdict"),
    Binding("back", "Shift+Space", "Frames", "Previous frame"),
    Binding("save", "Ctrl+S", "Frames", "Save (every stroke is saved anyway)"),
    Binding("order", "F5", "Frames", "Order by time, or the worst first"),
    Binding("colouring", "F2", "View", "Next colouring"),
    Binding("front_view", "F3", "View", "View of the depth camera"),
    Binding("theme", "F4", "View", "Light or dark"),
    Binding("help", "F1", "View", "Show or hide this page"),
)
"""All bindings, as delivered."""


@dataclass(frozen=True)
class Settings:
    """What a user sets in window.toml. theme: of THEMES; bindings: with the user's own keys."""

    theme: str = "system"
    bindings: tuple[Binding, ...] = BINDINGS

    def key(self, name: str) -> str:
        """The key of a binding. Raises KeyError for a name that does not exist."""
        return {binding.name: binding.key for binding in self.bindings}[name]


def settings_path() -> Path:
    """window.toml in the user's configuration folder (XDG Base Directory Specification 0.8)."""
    home = os.environ.get("XDG_CONFIG_HOME") or "~/.config"
    return Path(home) / "annotate-cloud" / "window.toml"


def load_settings(path: Path) -> Settings:
    """Read ``theme`` and the table ``[keys]`` (name = "Ctrl+K"); as delivered where there is no file.

    Raises CloudError naming the line, the name or the key that is wrong or used twice.
    """
    if not path.exists():
        return Settings()
    fields = read_toml(path, MAX_TOML_BYTES, "mend or remove it", CloudError)
    theme, keys = fields.pop("theme", "system"), fields.pop("keys", {})
    if fields:
        raise CloudError(f"{path}: {next(iter(fields))!r} is not a setting; use theme and [keys]")
    if theme not in THEMES:
        raise CloudError(f"{path}: theme is {theme!r}; use {', '.join(THEMES)}")
    return Settings(theme, _rebound(path, keys))


def _rebound(path: Path, keys: object) -> tuple[Binding, ...]:
    if not isinstance(keys, dict) or not all(isinstance(key, str) and key for key in keys.values()):
        raise CloudError(f'{path}: [keys] is not a table of keys; write lines such as undo = "Ctrl+Z"')
    names = {binding.name for binding in BINDINGS}
    unknown = sorted(set(keys) - names)
    if unknown:
        raise CloudError(f"{path}: [keys] names {unknown[0]!r}; use one of {', '.join(sorted(names))}")
    bindings = tuple(replace(b, key=keys.get(b.name, b.key)) for b in BINDINGS)
    key, count = Counter(b.key.casefold() for b in bindings).most_common(1)[0]
    if count > 1:
        both = " and ".join(b.name for b in bindings if b.key.casefold() == key)
        raise CloudError(f"{path}: {both} have the same key {key!r}; give each its own")
    return bindings
