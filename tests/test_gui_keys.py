"""Keys: complete, distinct, under the left hand, and movable by a file that is checked."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from annotate.gui.keys import BINDINGS, BODY_GRID, Settings, load_settings, settings_path
from annotate.parts import LEFT_RIGHT, PARTS
from sensors.errors import CloudError

LEFT_HAND = {*"`123456QWERTASDFGZXCVB", "Tab", "Space", "Esc", "F1", "F2", "F3", "F4", "F5"}


def test_every_key_is_its_own_and_under_the_left_hand():
    keys = [binding.key for binding in BINDINGS]
    assert len(set(keys)) == len(keys)
    for key in keys:
        *held, last = key.split("+")
        assert last in LEFT_HAND and set(held) <= {"Ctrl", "Shift"}, key


def test_parts_lie_like_a_body_that_faces_you():
    assert sorted(part for row in BODY_GRID for part in row) == [part.id for part in PARTS]
    column = {part: i for row in BODY_GRID for i, part in enumerate(row)}
    assert all(column[left] == 2 and column[right] == 0 for left, right in LEFT_RIGHT)


def test_without_a_file_keys_are_as_delivered(tmp_path):
    assert load_settings(tmp_path / "absent.toml") == Settings()


@given(st.sampled_from([b.name for b in BINDINGS]))
def test_one_key_moves_and_the_others_stay(tmp_path_factory, name):
    path = tmp_path_factory.mktemp("keys") / "window.toml"
    path.write_text(f'theme = "light"\n[keys]\n{name} = "Ctrl+K"\n#' + "x" * 99_900)
    settings = load_settings(path)
    assert settings.theme == "light" and settings.key(name) == "Ctrl+K"
    for binding in BINDINGS:
        assert binding.name == name or settings.key(binding.name) == binding.key


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("theme = 'pink'", "pink"),
        ("[keys]\nfly = 'F'", "fly"),
        ("[keys]\nundo = 7", "[keys]"),
        ("keys = 3", "[keys]"),
        ("[keys]\nundo = 'f1'", "undo and help"),
        ("colour = 'red'", "colour"),
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
