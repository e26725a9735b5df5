"""Keys: complete, distinct, under the left hand, and movable by a file that is checked."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from PySide6.QtCore import QEvent, Qt
from PySide6.QtGui import QKeyEvent
from PySide6.QtWidgets import QApplication, QWidget

from annotate.gui.held_keys import KeyRepeatFilter
from annotate.gui.state.keys import BODY_GRID, COMMANDS, LAYOUTS, Settings, load_settings, settings_path
from annotate.parts import LEFT_RIGHT, PARTS
from sensors.errors import CloudError

LEFT_HAND = {*"`123456QWERTASDFGZXCVBNH", "Tab", "Space", "Esc", *(f"F{i}" for i in range(1, 8))}
RIGHT_HAND = {"[", "]"}
"""The brush's size, which Shift and the wheel change too."""


def settings_of(tmp_path, text: str) -> Settings:
    (tmp_path / "window.toml").write_text(text)
    return load_settings(tmp_path / "window.toml")


def test_every_command_has_a_key_under_the_left_hand():
    for command in COMMANDS:
        *held, last = command.key.split("+")
        assert last in LEFT_HAND | RIGHT_HAND and set(held) <= {"Ctrl", "Shift"}, command.name


@pytest.mark.parametrize("layout", LAYOUTS)
def test_on_every_keyboard_each_key_is_its_own_and_lies_in_its_place(tmp_path, layout):
    settings = settings_of(tmp_path, f'layout = "{layout}"')
    keys = [key for command in settings.commands for key in command.keys]
    assert len({key.casefold() for key in keys}) == len(keys)
    bottom_left = {"qwerty": "Z", "qwertz": "Y", "azerty": "W"}[layout]
    assert settings.key("right_lower_leg") == bottom_left
    assert settings.key("lock_right_lower_leg") == f"Shift+{bottom_left}"
    assert settings.key("undo") == "Ctrl+Z", "as printed"


def test_parts_lie_like_a_body_that_faces_you():
    assert sorted(part for row in BODY_GRID for part in row) == [part.id for part in PARTS]
    column = {part: i for row in BODY_GRID for i, part in enumerate(row)}
    assert all(column[left] == 2 and column[right] == 0 for left, right in LEFT_RIGHT)


def test_without_a_file_keys_are_as_delivered(tmp_path):
    assert load_settings(tmp_path / "absent.toml") == Settings()


@given(st.sampled_from([command.name for command in COMMANDS]))
def test_one_key_moves_and_the_others_stay(tmp_path_factory, name):
    path = tmp_path_factory.mktemp("keys") / "window.toml"
    path.write_text(f'theme = "light"\n[keys]\n{name} = "Ctrl+K"\n#' + "x" * 99_900)
    settings = load_settings(path)
    assert settings.theme == "light" and settings.key(name) == "Ctrl+K"
    for command in COMMANDS:
        assert command.name == name or settings.key(command.name) == command.key


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("theme = 'pink'", "pink"),
        ("[keys]\nfly = 'F'", "fly"),
        ("[keys]\nundo = 7", "[keys]"),
        ("keys = 3", "[keys]"),
        ("[keys]\nundo = 'f1'", "undo and help"),
        ("colour = 'red'", "colour"),
        ("layout = 'dvorak'", "dvorak"),
        ("[keys]\nundo = 'Strg+Z'", "undo has the key 'Strg.Z', which does not exist"),
        ("[keys]\nfill_holes = 'Banana'", "fill_holes has the key 'Banana'"),
        ("[keys]\nswap = 'Shift+W'", "swap and lock_torso"),
        ("[keys", "cannot be read"),
        ("x = '" + "a" * 100_000 + "'", "larger"),
    ],
)
def test_what_is_wrong_in_the_file_is_named(tmp_path, text, says):
    path = tmp_path / "window.toml"
    path.write_text(text)
    with pytest.raises(CloudError, match=says.replace("[", r"\[")):
        load_settings(path)


def test_the_file_lies_where_the_desktop_says(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    assert settings_path() == tmp_path / "annotate-cloud" / "window.toml"


class Listener(QWidget):
    """A window that writes down when which keys are pressed."""

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


def test_a_press_in_the_millisecond_of_its_release_is_no_press(qapp):
    """As X11 repeats a held key; Qt knows it only where it reads both events at once."""
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
    window.send(up, space, 0)
    window.send(down, space, 0)
    assert window.pressed[-1] == (space, 0), "of a test, which gives no times"
