"""Commands of the window: names, keys and menus, and the user's file that changes the keys.

The keys of parts and tools lie under the left hand while the right hand holds the mouse.
"""

import os
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

from PySide6.QtCore import Qt
from PySide6.QtGui import QKeySequence

from annotate.parts import PARTS
from sensors.errors import CloudError
from sensors.files.bounded import read_toml

MAX_TOML_BYTES = 100_000  # largest window.toml
THEMES = ("system", "light", "dark")

BODY_KEYS = "123QWEASDZXC"
BODY_GRID = ((4, 1, 3), (6, 2, 5), (9, 7, 8), (11, 0, 10))
"""Part ids laid out like a body that faces the user: the right arm is at the left."""

_AZERTY_DIGITS = dict(zip("123456", "&É\"'(-", strict=True))
LAYOUTS: dict[str, dict[str, str]] = {
    "qwerty": {},
    "qwertz": {"Z": "Y", "Y": "Z", "`": "<", "[": "Ü", "]": "+"},
    "azerty": {"Q": "A", "A": "Q", "W": "Z", "Z": "W", "`": "<", "[": ")", "]": "=", **_AZERTY_DIGITS},
}
"""Keys by layout, where they differ from those in the same place of a US keyboard. Letters with Ctrl stay as
printed (Ctrl+Z undoes everywhere)."""


@dataclass(frozen=True)
class Command:
    """Command of the window.

    name: as in window.toml. key, also: main and second key in Qt's notation, or "". title: in menus and on
    buttons. hint: on the page of keys. repeats: True if a held key repeats it.
    """

    name: str
    key: str
    menu: str
    title: str
    hint: str = ""
    also: str = ""
    repeats: bool = False

    @property
    def keys(self) -> tuple[str, ...]:
        """Return the keys of the command, the main one first."""
        return tuple(filter(None, (self.key, self.also)))


_PART_TITLES = {part.id: part.title if part.id else "Background: erase" for part in PARTS}
COMMANDS: tuple[Command, ...] = (
    *(
        Command(PARTS[i].name, key, "Parts", _PART_TITLES[i])
        for i, key in zip(chain(*BODY_GRID), BODY_KEYS, strict=True)
    ),
    Command("undefined", "Ctrl+X", "Parts", "Undefined"),
    Command("pick", "`", "Parts", "Part under the pointer", "Choose the part under the pointer"),
    Command("from_other", "Ctrl+4", "Parts", "As in the other set", "Strokes give the other set's parts"),
    Command(
        "from_before",
        "Ctrl+5",
        "Parts",
        "As in the frame before",
        "Strokes give the parts of the frame before",
    ),
    Command("piece", "F", "Tools", "Piece", "Click a piece, click again to grow it"),
    Command("lasso", "G", "Tools", "Lasso", "Draw a loop"),
    Command("polygon", "T", "Tools", "Polygon", "Click corners, Return closes it"),
    Command("rectangle", "R", "Tools", "Rectangle", "Drag a rectangle"),
    Command("brush", "B", "Tools", "Brush", "Drag over it"),
    Command("small", "Ctrl+1", "Tools", "Small brush"),
    Command("medium", "Ctrl+2", "Tools", "Medium brush"),
    Command("large", "Ctrl+3", "Tools", "Large brush"),
    Command("smaller", "[", "Tools", "Smaller brush", repeats=True),
    Command("larger", "]", "Tools", "Larger brush", repeats=True),
    Command("through", "Tab", "Tools", "Through the body", "Through the body, not only its surface"),
    Command("only", "4", "Tools", "Only the part I start on", "Replace only the part where a stroke starts"),
    Command("room", "6", "Tools", "Include background", "Change the background too, not only the body"),
    Command("cancel", "Esc", "Tools", "Cancel", "Cancel the stroke or the preview"),
    Command("undo", "Ctrl+Z", "Edit", "Undo", "Undo strokes and verdicts of this frame", repeats=True),
    Command("redo", "Ctrl+Shift+Z", "Edit", "Redo", "Redo what was undone", "Ctrl+Y", repeats=True),
    Command("swap", "V", "Edit", "Swap left/right", "Swap left and right of the limb under the pointer"),
    Command("neighbour", "5", "Edit", "Give patch to neighbour", "Give the patch here to its neighbour"),
    Command("merge", "Ctrl+E", "Edit", "Merge part", "Turn the part under the pointer into the chosen one"),
    Command("remove_islands", "Ctrl+D", "Edit", "Islands", "Mark islands of all parts; again: remove"),
    Command("fill_holes", "Ctrl+F", "Edit", "Holes", "Mark holes of the chosen part; again: fill"),
    Command("copy_previous", "Ctrl+V", "Edit", "Copy previous frame", "Copy the parts of the frame before"),
    Command("accept", "Space", "Frames", "Accept", "Accept or agree; open the next frame"),
    Command("reject", "Ctrl+R", "Frames", "Reject…", "Reject with a reason, or agree to that"),
    Command("overrule", "Ctrl+Shift+A", "Frames", "Accept although rejected", "Overrule a rejection"),
    Command("doubt", "N", "Frames", "Next doubtful place", "Show the next doubtful place", repeats=True),
    Command("next", "Ctrl+Space", "Frames", "Next frame", "Next frame, without a verdict", "Right", True),
    Command("back", "Shift+Space", "Frames", "Previous frame", "Previous frame", "Left", True),
    Command("learn", "Ctrl+Shift+T", "Frames", "Learn", "Learn from accepted frames, label the rest"),
    Command("stop_learning", "Ctrl+Shift+X", "Frames", "Stop learning", "Stop learning; labels stay"),
    Command("unlearn", "Ctrl+Shift+R", "Frames", "Unlearn", "Restore the labels from before learning"),
    Command("go_to", "Ctrl+T", "Frames", "Go to frame…", "Go to a frame by its number"),
    Command("order", "F5", "Frames", "Next order", "By time, worst first, most useful first, or for review"),
    Command("filter", "F6", "Frames", "Next filter", "All frames, or those in one state"),
    Command("colouring", "F2", "View", "Next colouring", "Next colouring of the pane under the pointer"),
    Command("outlines", "Ctrl+W", "View", "Part outlines", "Outlines of parts over the pane"),
    Command("tint", "Ctrl+Q", "View", "Part opacity", "Parts over the pane: none, faint, half, strong"),
    Command("onion", "Ctrl+B", "View", "Outlines of the frame before", "Outlines of the frame before"),
    Command("peek", "H", "View", "Peek (hold)", "Hold it to see the pane without parts"),
    Command("solo", "Ctrl+A", "View", "Chosen part alone", "Show only the chosen part, or all again"),
    Command("swap_views", "F7", "View", "Swap the views", "Cloud and depth image swap places"),
    Command("front_view", "F3", "View", "View of the camera", "View of the depth camera"),
    Command("theme", "F4", "View", "Light or dark"),
    Command("save", "Ctrl+S", "File", "Save", "Save (every stroke is saved anyway)"),
    Command("export", "Ctrl+Shift+E", "File", "Export…", "Export for another tool"),
    Command("close", "Ctrl+Shift+Q", "File", "Close"),
    Command("help", "F1", "Help", "All keys", "Show or hide this page"),
)
"""All commands, as delivered for US keyboards. Locks and fading follow from the parts' keys."""


def derived(commands: tuple[Command, ...]) -> tuple[Command, ...]:
    """Return the commands that lock and fade each part.

    Their keys are Shift and Alt with the part's key, or none if the part's key has modifiers itself.
    """
    keys = {command.name: command.key for command in commands}
    made = []
    for part in PARTS:
        key = keys[part.name] if "+" not in keys[part.name][:-1] else ""
        for verb, held in (("lock", "Shift"), ("fade", "Alt")):
            title = f"{verb.capitalize()} {part.title.lower()}"
            made.append(Command(f"{verb}_{part.name}", key and f"{held}+{key}", verb.capitalize(), title))
    return tuple(made)


@dataclass(frozen=True)
class Settings:
    """Settings of a user in window.toml. theme: of THEMES. commands: with the user's keys."""

    theme: str = "system"
    commands: tuple[Command, ...] = (*COMMANDS, *derived(COMMANDS))

    def command(self, name: str) -> Command:
        """Return a command by name. Raises KeyError for an unknown name."""
        return {command.name: command for command in self.commands}[name]

    def key(self, name: str) -> str:
        """Return the main key of a command. Raises KeyError for an unknown name."""
        return self.command(name).key


def settings_path() -> Path:
    """Return window.toml in the user's configuration folder (XDG Base Directory Specification 0.8)."""
    home = os.environ.get("XDG_CONFIG_HOME") or "~/.config"
    return Path(home) / "annotate-cloud" / "window.toml"


def load_settings(path: Path) -> Settings:
    """Read ``theme``, ``layout`` and the table ``[keys]`` (name = "Ctrl+K"); the defaults without a file.

    Raises CloudError with the wrong line, the unknown name, or the key that two commands have.
    """
    if not path.exists():
        return Settings()
    fields = read_toml(path, MAX_TOML_BYTES, "correct or remove it", CloudError)
    theme, layout = fields.pop("theme", "system"), fields.pop("layout", "qwerty")
    keys = fields.pop("keys", {})
    if fields:
        raise CloudError(f"{path}: {next(iter(fields))!r} is not a setting; use theme, layout and [keys]")
    if theme not in THEMES:
        raise CloudError(f"{path}: theme is {theme!r}; use {', '.join(THEMES)}")
    if layout not in LAYOUTS:
        raise CloudError(f"{path}: layout is {layout!r}; use {', '.join(LAYOUTS)}")
    return Settings(theme, _rebound(path, laid_out(layout), keys))


def laid_out(layout: str) -> tuple[Command, ...]:
    """Return all but the derived commands, with their keys on a keyboard layout."""
    places = LAYOUTS[layout]

    def moved(key: str) -> str:
        *held, last = key.rsplit("+", 1)
        stays = "Ctrl" in "".join(held) and last.isalpha()
        return key if stays else "+".join([*held, places.get(last, last)])

    return tuple(replace(c, key=moved(c.key), also=moved(c.also)) for c in COMMANDS)


def _rebound(path: Path, commands: tuple[Command, ...], keys: object) -> tuple[Command, ...]:
    if not isinstance(keys, dict) or not all(isinstance(key, str) and key for key in keys.values()):
        raise CloudError(f'{path}: [keys] is not a table of keys; write lines such as undo = "Ctrl+Z"')
    mine = _with_keys(commands, keys)
    everything = (*mine, *_with_keys(derived(mine), keys))
    names = {command.name for command in everything}
    if unknown := sorted(set(keys) - names):
        raise CloudError(f"{path}: [keys] names {unknown[0]!r}; use one of {', '.join(sorted(names))}")
    for name, key in keys.items():
        if key_of(key) == Qt.Key.Key_unknown:
            raise CloudError(f'{path}: {name} has the key {key!r}, which does not exist; write e.g. "Ctrl+K"')
    users: defaultdict[str, list[str]] = defaultdict(list)
    for command in everything:
        for key in command.keys:
            users[QKeySequence(key).toString()].append(command.name)
    for key, both in users.items():
        if len(both) > 1:
            raise CloudError(f"{path}: {' and '.join(both)} have the same key {key!r}; give each its own")
    return everything


def _with_keys(commands: tuple[Command, ...], keys: Mapping[str, str]) -> tuple[Command, ...]:
    return tuple(replace(c, key=keys[c.name], also="") if c.name in keys else c for c in commands)


def key_of(text: str) -> Qt.Key:
    """Return the key of a text in Qt's notation without modifiers; Key_unknown unless it is one key."""
    sequence = QKeySequence(text)
    if sequence.count() != 1:
        return Qt.Key.Key_unknown
    key: Qt.Key = sequence[0].key()  # type: ignore[index]  # missing in PySide6's types
    return key
