"""Files of weights are whole or not, whatever byte they end at."""

from importlib.resources import files
from pathlib import Path

import pytest

from sensors.errors import FormatError
from sensors.files.weights_file import check_onnx, check_safetensors

SHIPPED = Path(str(files("eval").joinpath("weights")))


@pytest.mark.parametrize(
    ("name", "check"), [("compact.onnx", check_onnx), ("compact.safetensors", check_safetensors)]
)
def test_no_shorter_and_no_longer_file_is_whole(tmp_path, name, check):
    whole, other = (SHIPPED / name).read_bytes(), tmp_path / "w"
    check(SHIPPED / name)
    for size in (0, 1, 7, 8, 9, 100, len(whole) // 2, len(whole) - 1):
        other.write_bytes(whole[:size])
        with pytest.raises(FormatError, match="cut off"):
            check(other)
    other.write_bytes(whole + b"more")
    with pytest.raises(FormatError, match="cut off"):
        check(other)
    with pytest.raises(FormatError, match="not a file"):
        check(tmp_path)
