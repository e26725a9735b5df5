"""A TOML file is what tomllib reads, or one line."""

import tomllib

import pytest

from sensors.errors import DeviceError, FormatError
from sensors.files.bounded import read_toml

MANY_DOTS = f"x = [{', '.join(f'{i}.5' for i in range(150))}]  # {'...' * 50}\n"
GOOD = 'name = "a.b"\n[t."c.d"]\nx = [1.5, 2]\ny = { z = 9223372036854775807 }\n'
DEEP = f"a{'.a' * 9} = 1\nb = {'[' * 9}{']' * 9}\n"


@pytest.mark.parametrize("content", [GOOD, MANY_DOTS, DEEP])
def test_a_good_file_is_what_tomllib_reads(tmp_path, content):
    file = tmp_path / "a.toml"
    file.write_text(content)
    assert read_toml(file, len(content), "mend it") == tomllib.loads(content)
    with pytest.raises(FormatError, match=r"a\.toml is larger than \d+ bytes; mend it$"):
        read_toml(file, len(content) - 1, "mend it")


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"a = " + b"[" * 20_000, "recursion"),
        (b"a = 1" + b"0" * 5000, "digits"),
        (b"a = \xff", "decode"),
        (b"a = 1\na = 2\n#", "line 2"),
        (b"#" * 30_000, "larger than"),
    ],
)
def test_others_are_one_line(tmp_path, content, says):
    file = tmp_path / "a.toml"
    file.write_bytes(content)
    for error in (FormatError, DeviceError):
        with pytest.raises(error, match=rf"a\.toml .*{says}.*; mend it$") as caught:
            read_toml(file, 25_000, "mend it", error)
        assert "\n" not in str(caught.value)
