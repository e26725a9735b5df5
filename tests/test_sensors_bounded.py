"""No file from outside is read beyond its bound, and what cannot be read is one line."""

import os
from pathlib import Path

import pytest

from sensors.errors import CalibrationError, FormatError
from sensors.files.bounded import read_bounded


def test_a_file_is_read_up_to_its_bound(tmp_path):
    file = tmp_path / "f"
    file.write_bytes(b"12345")
    assert read_bounded(file, 5) == b"12345"
    with pytest.raises(FormatError, match=r"f is larger than 4 bytes; split it"):
        read_bounded(file, 4, "split it")
    with pytest.raises(CalibrationError, match=r"g cannot be read \(No such file or directory\); restore it"):
        read_bounded(tmp_path / "g", error=CalibrationError)
    with pytest.raises(FormatError, match=r"null byte"):
        read_bounded(tmp_path / "\0")


def test_what_never_ends_or_blocks_is_no_file(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "endless").symlink_to("/dev/zero")
    for name in ("pipe", "endless"):
        with pytest.raises(CalibrationError, match=rf"{name} is no file; split it"):
            read_bounded(tmp_path / name, 10, "split it", CalibrationError)


def test_links_to_files_and_files_without_a_size_are_read_whole(tmp_path):
    (tmp_path / "f").write_bytes(b"12345")
    (tmp_path / "link").symlink_to("f")
    assert read_bounded(tmp_path / "link", 5) == b"12345"
    version = Path("/proc/version").read_bytes()
    assert read_bounded(Path("/proc/version"), len(version)) == version
    with pytest.raises(FormatError, match="larger"):
        read_bounded(Path("/proc/version"), len(version) - 1)
