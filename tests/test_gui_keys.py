"""Keys: complete, distinct, under the left hand, and movable by a file that is checked."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from annotate.gui.keys import BODY_GRID, COMMANDS, LAYOUTS, Settings, load_settings, settings_path
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
