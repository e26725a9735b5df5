"""A TOML file is what tomllib reads, or one line; nothing in it costs more than its length."""

import tomllib

import pytest

from sensors.errors import DeviceError, FormatError
from sensors.files.toml_file import MAX_DEPTH, MAX_DOTS, read_toml

GOOD = 'name = "a.b"\n[t."c.d"]\nx = [1.5, 2]\ny = { z = 9223372036854775807 }\n'


def test_a_good_file_is_what_tomllib_reads(tmp_path):
    file = tmp_path / "a.toml"
    file.write_text(GOOD)
    assert read_toml(file, 1000, "mend it") == tomllib.loads(GOOD)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"a" + b".a" * (MAX_DOTS + 1) + b" = 1", "full stops"),
        (b'x = { b = """\n\'""", a' + b".a" * (MAX_DOTS + 1) + b" = 1, c = '' }", "full stops"),
        (b"a" + '."\u2028"'.encode() * (MAX_DOTS + 1) + b" = 1", "full stops"),
        (b"a" + b".a" * MAX_DEPTH + b" = 1", "deep"),
        (b"a = " + b"[" * MAX_DEPTH + b"]" * MAX_DEPTH, "deep"),
        (b"a = " + b"[" * 20_000, "recursion"),
        (b"a = 0x8000000000000000", "64 bits"),
        (b"a = [[-9223372036854775809]]", "64 bits"),
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
