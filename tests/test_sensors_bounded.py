"""No file from outside is read beyond its bound, and what cannot be read is one line."""

import pytest

from sensors.bounded import read_bounded
from sensors.errors import CalibrationError, FormatError


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
