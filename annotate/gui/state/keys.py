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

from annotate.parts import PAPER
from annotate.scheme.body_grid import body_grid, thing_grid
from annotate.scheme.scheme import BACKGROUND, UNDEFINED, Scheme
from annotate.scheme.scheme_file import SHIPPED, load_scheme
from sensors.errors import CloudError
from sensors.files.bounded import read_toml

MAX_TOML_BYTES = 100_000  # largest window.toml
THEMES = ("system", "light", "dark")

_AZERTY_DIGITS = dict(zip("1234567890", "&É\"'(-È_ÇÀ", strict=True))
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
    buttons. hint: on the page of keys. repeats: True if a held key repeats it. part: id of the part that the
    command chooses, locks or fades, or None.
    """

    name: str
    key: str
    menu: str
    title: str
    hint: str = ""
    also: str = ""
    repeats: bool = False
    part: int | None = None

    @property
    def keys(self) -> tuple[str, ...]:
        """Return the keys of the command, the main one first."""
        return tuple(filter(None, (self.key, self.also)))


COMMANDS: tuple[Command, ...] = (
    Command("undefined", "Ctrl+X", "Parts", "Undefined", part=UNDEFINED),
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
    Command("witness", "Ctrl+G", "View", "Colour network", "Joints and outline by the colour network"),
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
"""Commands of all schemes, as delivered for US keyboards."""


def key_of(text: str) -> Qt.Key:
    """Return the key of a text in Qt's notation without modifiers; Key_unknown unless it is one key."""
    sequence = QKeySequence(text)
    if sequence.count() != 1:
        return Qt.Key.Key_unknown
    key: Qt.Key = sequence[0].key()  # type: ignore[index]  # missing in PySide6's types
    return key


def part_commands(scheme: Scheme, commands: tuple[Command, ...] = COMMANDS) -> tuple[Command, ...]:
    """Return the commands that choose the parts of a scheme, in the order of the palette.

    commands: all others. A part without a key of its own, or with a key of these, has none; neither has a key
    with Shift or Alt. A part with the name of a command gets the prefix ``part_``.
    """
    taken = {_folded(key) for command in commands for key in command.keys}
    names = {command.name for command in commands}
    names |= {f"{verb}_{part.name}" for verb in ("lock", "fade") for part in scheme.by_id.values()}
    made = []
    for part_id in chain(*body_grid(scheme), *thing_grid(scheme)):
        if part_id is None:
            continue
        part = scheme.by_id[part_id]
        is_free = key_of(part.key) != Qt.Key.Key_unknown and _folded(part.key) not in taken
        key = part.key if is_free and not {"Shift", "Alt"} & {*_folded(part.key).split("+")} else ""
        taken.add(_folded(key))
        name = part.name
        while name in names:
            name = f"part_{name}"
        names.add(name)
        title = f"{part.title}: erase" if part_id == BACKGROUND else part.title
        made.append(Command(name, key, "Parts", title, part=part_id))
    return tuple(made)


def derived(commands: tuple[Command, ...]) -> tuple[Command, ...]:
    """Return the commands that lock and fade each part.

    Their keys are Shift and Alt with the part's key, or none if the part's key has modifiers itself or is
    missing.
    """
    made = []
    for command in sorted((c for c in commands if c.part not in (None, UNDEFINED)), key=_part_of):
        key = command.key if "+" not in command.key[:-1] else ""
        for verb, held in (("lock", "Shift"), ("fade", "Alt")):
            title = f"{verb.capitalize()} {command.title.removesuffix(': erase').lower()}"
            of_part = key and f"{held}+{key}"
            made.append(
                Command(f"{verb}_{command.name}", of_part, verb.capitalize(), title, part=command.part)
            )
    return tuple(made)


def _part_of(command: Command) -> int:
    assert command.part is not None
    return command.part


def _folded(key: str) -> str:
    return QKeySequence(key).toString()


def commands_of(scheme: Scheme) -> tuple[Command, ...]:
    """Return all commands for a scheme, as delivered for US keyboards."""
    parts = part_commands(scheme)
    return (*parts, *COMMANDS, *derived(parts))


@dataclass(frozen=True)
class Settings:
    """Settings of a user in window.toml. theme: of THEMES. commands: for one scheme, with the user's keys."""

    theme: str = "system"
    commands: tuple[Command, ...] = commands_of(PAPER)

    def command(self, name: str) -> Command:
        """Return a command by name. Raises KeyError for an unknown name."""
        return {command.name: command for command in self.commands}[name]

    def key(self, name: str) -> str:
        """Return the main key of a command. Raises KeyError for an unknown name."""
        return self.command(name).key

    def part_key(self, part: int) -> str:
        """Return the key that chooses a part, or ""."""
        return next(command.key for command in self.commands if command.part == part)


def settings_path() -> Path:
    """Return window.toml in the user's configuration folder (XDG Base Directory Specification 0.8)."""
    home = os.environ.get("XDG_CONFIG_HOME") or "~/.config"
    return Path(home) / "annotate-cloud" / "window.toml"


def load_settings(path: Path, scheme: Scheme = PAPER) -> Settings:
    """Read ``theme``, ``layout`` and the table ``[keys]`` (name = "Ctrl+K"); the defaults without a file.

    Raises CloudError with the wrong line, the unknown name, or the key that two commands have.
    """
    if not path.exists():
        return Settings(commands=commands_of(scheme))
    fields = read_toml(path, MAX_TOML_BYTES, "correct or remove it", CloudError)
    theme, layout = fields.pop("theme", "system"), fields.pop("layout", "qwerty")
    keys = fields.pop("keys", {})
    if fields:
        raise CloudError(f"{path}: {next(iter(fields))!r} is not a setting; use theme, layout and [keys]")
    if theme not in THEMES:
        raise CloudError(f"{path}: theme is {theme!r}; use {', '.join(THEMES)}")
    if layout not in LAYOUTS:
        raise CloudError(f"{path}: layout is {layout!r}; use {', '.join(LAYOUTS)}")
    parts = part_commands(scheme)
    return Settings(theme, _rebound(path, laid_out((*parts, *COMMANDS), layout), keys))


def laid_out(commands: tuple[Command, ...], layout: str) -> tuple[Command, ...]:
    """Return commands with their keys on a keyboard layout."""
    places = LAYOUTS[layout]

    def moved(key: str) -> str:
        *held, last = key.rsplit("+", 1)
        stays = "Ctrl" in "".join(held) and last.isalpha()
        return key if stays else "+".join([*held, places.get(last, last)])

    return tuple(replace(c, key=moved(c.key), also=moved(c.also)) for c in commands)


def _rebound(path: Path, commands: tuple[Command, ...], keys: object) -> tuple[Command, ...]:
    """Return commands with the user's keys, and the commands that follow from them.

    Names of parts in shipped schemes are allowed in every scheme.
    """
    if not isinstance(keys, dict) or not all(isinstance(key, str) and key for key in keys.values()):
        raise CloudError(f'{path}: [keys] is not a table of keys; write lines such as undo = "Ctrl+Z"')
    mine = _with_keys(commands, keys)
    everything = (*mine, *_with_keys(derived(mine), keys))
    names = {command.name for command in everything}
    elsewhere = {command.name for name in SHIPPED for command in commands_of(load_scheme(name))}
    if unknown := sorted(set(keys) - names - elsewhere):
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
