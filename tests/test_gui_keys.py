"""Keys: complete, distinct, under the left hand, and movable by a file that is checked."""

import pytest
from PySide6.QtCore import QEvent, Qt
from PySide6.QtGui import QKeyEvent
from PySide6.QtWidgets import QApplication, QWidget

from annotate.gui.held_keys import KeyRepeatFilter
from annotate.gui.state.keys import BODY_GRID, COMMANDS, LAYOUTS, Settings, load_settings, settings_path
from annotate.parts import LEFT_RIGHT, PARTS
from sensors.errors import CloudError

LEFT_HAND = {*"`123456QWERTASDFGZXCVBNH", "Tab", "Space", "Esc", *(f"F{i}" for i in range(1, 8))}
BRUSH_SIZE = {"[", "]"}


def settings_of(tmp_path, text: str) -> Settings:
    (tmp_path / "window.toml").write_text(text)
    return load_settings(tmp_path / "window.toml")


def test_every_command_has_a_key_under_the_left_hand():
    for command in COMMANDS:
        *held, last = command.key.split("+")
        assert last in LEFT_HAND | BRUSH_SIZE and set(held) <= {"Ctrl", "Shift"}, command.name


@pytest.mark.parametrize("layout", LAYOUTS)
def test_on_every_keyboard_each_key_is_its_own_and_lies_in_its_place(tmp_path, layout):
    settings = settings_of(tmp_path, f'layout = "{layout}"')
    keys = [key for command in settings.commands for key in command.keys]
    assert len({key.casefold() for key in keys}) == len(keys)
    bottom_left = {"qwerty": "Z", "qwertz": "Y", "azerty": "W"}[layout]
    assert settings.key("right_lower_leg") == bottom_left
    assert settings.key("lock_right_lower_leg") == f"Shift+{bottom_left}"
    assert settings.key("undo") == "Ctrl+Z", "as printed"


def test_parts_lie_like_a_body_that_faces_the_user():
    assert sorted(part for row in BODY_GRID for part in row) == [part.id for part in PARTS]
    column = {part: i for row in BODY_GRID for i, part in enumerate(row)}
    assert all(column[left] == 2 and column[right] == 0 for left, right in LEFT_RIGHT)


def test_one_key_moves_and_the_others_stay(tmp_path, monkeypatch):
    assert load_settings(tmp_path / "absent.toml") == Settings()
    for name in [command.name for command in COMMANDS]:
        settings = settings_of(tmp_path, f'theme = "light"\n[keys]\n{name} = "Ctrl+K"\n')
        assert settings.theme == "light" and settings.key(name) == "Ctrl+K"
        for command in COMMANDS:
            assert command.name == name or settings.key(command.name) == command.key
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    assert settings_path() == tmp_path / "annotate-cloud" / "window.toml"


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("theme = 'pink'", "pink"),
        ("[keys]\nfly = 'F'", "fly"),
        ("[keys]\nundo = 7", "[keys]"),
        ("keys = 3", "[keys]"),
        ("[keys]\nundo = 'f1'", "undo and help"),
        ("colour = 'red'", "colour"),
        ("layout = 'dvorak'", "dvorak"),
        ("[keys]\nundo = 'Strg+Z'", "Strg+Z"),
        ("[keys]\nswap = 'Shift+W'", "swap and lock_torso"),
        ("[keys", "cannot be read"),
    ],
)
def test_the_fault_in_the_file_is_named(tmp_path, text, named):
    with pytest.raises(CloudError) as refusal:
        settings_of(tmp_path, text)
    assert named in str(refusal.value)


class Listener(QWidget):
    """Window that writes down when which keys are pressed."""

    def __init__(self) -> None:
        super().__init__()
        self.pressed: list[tuple[int, int]] = []
        KeyRepeatFilter(self)

    def keyPressEvent(self, event: QKeyEvent) -> None:  # noqa: N802
        self.pressed.append((event.key(), event.timestamp()))

    def send(self, kind: QEvent.Type, key: Qt.Key, at_ms: int, *, repeated: bool = False) -> bool:
        event = QKeyEvent(kind, key, Qt.KeyboardModifier.NoModifier, "", repeated)
        event.setTimestamp(at_ms)
        event.setAccepted(kind == QEvent.Type.KeyPress)
        QApplication.sendEvent(self.windowHandle(), event)
        return event.isAccepted()


def test_a_press_in_the_millisecond_of_its_release_is_dropped(qapp):
    """X11 repeats a held key so; Qt recognises it only where it reads both events at once."""
    down, up, asked = QEvent.Type.KeyPress, QEvent.Type.KeyRelease, QEvent.Type.ShortcutOverride
    space, other = Qt.Key.Key_Space, Qt.Key.Key_W
    window = Listener()
    window.send(down, space, 10)
    for at_ms in (700, 740):
        window.send(up, space, at_ms)
        assert window.send(asked, space, at_ms), "no command may take it"
        window.send(down, space, at_ms)
    assert window.pressed == [(space, 10)]
    window.send(up, space, 780)
    assert not window.send(asked, other, 780)
    for key, at_ms, repeated in ((other, 780, False), (space, 780, True), (space, 800, False)):
        window.send(down, key, at_ms, repeated=repeated)
    assert window.pressed[1:] == [(other, 780), (space, 780), (space, 800)]
