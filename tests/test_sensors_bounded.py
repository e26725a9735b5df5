"""No file from outside is read beyond its bound, and what cannot be read is one line."""

import os
from pathlib import Path

import numpy as np
import pytest

from sensors.errors import CalibrationError, FormatError
from sensors.files.bounded import read_bounded
from sensors.files.npz import array_sizes, load_arrays


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
        with pytest.raises(CalibrationError, match=rf"{name} is not a file; split it"):
            read_bounded(tmp_path / name, 10, "split it", CalibrationError)


def test_links_to_files_and_files_without_a_size_are_read_whole(tmp_path):
    (tmp_path / "f").write_bytes(b"12345")
    (tmp_path / "link").symlink_to("f")
    assert read_bounded(tmp_path / "link", 5) == b"12345"
    version = Path("/proc/version").read_bytes()
    assert read_bounded(Path("/proc/version"), len(version)) == version
    with pytest.raises(FormatError, match="larger"):
        read_bounded(Path("/proc/version"), len(version) - 1)


def test_arrays_are_unpacked_up_to_their_bound(tmp_path):
    file, kept = tmp_path / "a.npz", {"a": np.arange(9.0).reshape(3, 3), "names": np.array(["x", "y"])}
    np.savez_compressed(file, **kept, large=np.zeros(10_000))
    sizes = array_sizes(file, "split it")
    assert set(sizes) == {"a", "names", "large"}
    total = sum(sizes.values())
    for names, limit in ((None, total), (("a", "names", "none"), total - sizes["large"])):
        arrays = load_arrays(file, limit, "split it", names)
        assert set(arrays) == {name for name in sizes if names is None or name in names}
        for name, expected in kept.items():
            np.testing.assert_array_equal(arrays[name], expected)
        with pytest.raises(FormatError, match=r"a\.npz unpacks to \d+ bytes.*; split it$"):
            load_arrays(file, limit - 1, "split it", names)


def test_what_are_no_arrays_is_refused(tmp_path):
    file = tmp_path / "a.npz"
    np.savez(file, a=np.zeros(5000))
    whole = file.read_bytes()
    np.savez(file, a=np.array([{}], object))
    pickled = file.read_bytes()
    np.savez(file, a=np.zeros(100_001, "V0"))
    for content in (b"", whole[:-1000], whole[:2000] + b"x" + whole[2001:], pickled, file.read_bytes()):
        file.write_bytes(content)
        with pytest.raises(FormatError, match=r"; split it$"):
            load_arrays(file, 100_000, "split it")
