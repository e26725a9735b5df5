"""Keys: complete, distinct, under the left hand, and movable by a file that is checked."""

import pytest
from PySide6.QtCore import QEvent, Qt
from PySide6.QtGui import QKeyEvent
from PySide6.QtWidgets import QApplication, QWidget

from annotate.gui.held_keys import KeyRepeatFilter
from annotate.gui.state.keys import COMMANDS as OF_ALL_SCHEMES
from annotate.gui.state.keys import (
    LAYOUTS,
    Settings,
    commands_of,
    load_settings,
    part_commands,
    settings_path,
)
from annotate.parts import LEFT_RIGHT, PAPER, PARTS
from annotate.scheme.body_grid import body_grid, thing_grid
from annotate.scheme.scheme import Part, scheme_of
from annotate.scheme.scheme_file import SHIPPED, load_scheme
from sensors.errors import CloudError
from tests.helpers.schemes import WARD

LEFT_HAND = {*"`123456QWERTASDFGZXCVBNH", "Tab", "Space", "Esc", *(f"F{i}" for i in range(1, 8))}
BRUSH_SIZE = {"[", "]"}
BODY_GRID, COMMANDS = body_grid(PAPER), (*part_commands(PAPER), *OF_ALL_SCHEMES)
SCHEMES = [*map(load_scheme, SHIPPED), WARD]


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


def test_the_paper_s_keys_lie_as_its_parts():
    assert BODY_GRID == ((4, 1, 3), (6, 2, 5), (9, 7, 8), (11, 0, 10))
    keys = [Settings().part_key(part) for row in BODY_GRID for part in row]
    assert "".join(keys) == "123QWEASDZXC"


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: scheme.name)
def test_every_part_has_one_place_and_twins_face_each_other(scheme):
    rows = [*body_grid(scheme), *thing_grid(scheme)]
    placed = [part for row in rows for part in row if part is not None]
    assert sorted(placed) == sorted(scheme.by_id)
    for left, right in scheme.twins:
        assert any((row[0], row[2]) == (right, left) for row in rows)
    assert all(scheme.is_thing[part] for row in thing_grid(scheme) for part in row if part is not None)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: scheme.name)
def test_keys_of_every_scheme_are_their_own_on_every_keyboard(tmp_path, scheme, layout):
    (tmp_path / "window.toml").write_text(f'layout = "{layout}"')
    settings = load_settings(tmp_path / "window.toml", scheme)
    keys = [key.casefold() for command in settings.commands for key in command.keys]
    names = [command.name for command in settings.commands]
    assert len(set(keys)) == len(keys) and len(set(names)) == len(names)
    assert {c.part for c in settings.commands if c.menu == "Lock"} == {*scheme.by_id}


def test_a_part_leaves_a_command_its_key_and_its_name():
    things = [
        ("brush", "J"),
        ("thing_2", "F"),
        ("thing_3", "Space"),
        ("thing_4", "Shift+W"),
        ("lock_hip", ""),
    ]
    parts = [Part(20 + i, name, name, (0, 0, 0), key) for i, (name, key) in enumerate(things)]
    commands = commands_of(scheme_of("mine", [*PAPER.parts, *parts]))
    of_part = {c.part: c for c in commands if c.menu == "Parts"}
    assert [(of_part[i].name, of_part[i].key) for i in range(20, 25)] == [
        ("part_brush", "J"),
        ("thing_2", ""),
        ("thing_3", ""),
        ("thing_4", ""),
        ("part_lock_hip", ""),
    ]
    by_name = {command.name: command for command in commands}
    assert len(by_name) == len(commands) and by_name["brush"].menu == "Tools"
    assert by_name["lock_part_brush"].key == "Shift+J" and by_name["fade_thing_2"].key == ""


def test_a_key_of_another_shipped_scheme_s_part_is_no_fault(tmp_path):
    assert settings_of(tmp_path, '[keys]\nleft_collar = "F9"') == Settings()


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
