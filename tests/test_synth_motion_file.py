"""Motion files: what is saved comes back; small ones that claim much are refused before it is unpacked."""

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest

from sensors.errors import FormatError
from synth.body.skeleton import N_JOINTS
from synth.markers import plain_arrays
from synth.markers.motion_file import MarkerReport, Motion, load_motion, save_motion


def motion(frames: int = 5, names: tuple[str, ...] = ("LASI", "größer")) -> Motion:
    rng = np.random.default_rng(0)
    report = MarkerReport(
        names,
        rng.random((frames, len(names))).astype(np.float32),
        rng.integers(0, 5, (frames, len(names))).astype(np.uint8),
        ("unknown",),
    )
    angles, pelvis = rng.random((frames, N_JOINTS, 3)), rng.random((frames, 3))
    return Motion(angles, pelvis, 100.0, 0.8, report)


def spoilt(path: Path, name: str, content: bytes, packing: int = zipfile.ZIP_DEFLATED) -> Path:
    """A motion one of whose arrays has these bytes."""
    save_motion(path, motion(), overwrite=True)
    with zipfile.ZipFile(path) as archive:
        members = {info.filename: archive.read(info) for info in archive.infolist()}
    with zipfile.ZipFile(path, "w", packing) as archive:
        for member, data in {**members, f"{name}.npy": content}.items():
            archive.writestr(member, data)
    return path


def npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=True)
    return stream.getvalue()


@pytest.mark.parametrize("names", [(), ("LASI", "größer")])
def test_a_motion_comes_back(tmp_path, names):
    saved = motion(names=names)
    save_motion(tmp_path / "m.npz", saved)
    found = load_motion(tmp_path / "m.npz")
    assert (found.report.names, found.report.unknown) == (names, ("unknown",))
    assert (found.leg_m, found.frames_per_second) == (saved.leg_m, saved.frames_per_second)
    for name in ("angles_rad", "pelvis_m"):
        np.testing.assert_array_equal(getattr(found, name), getattr(saved, name))
    for name in ("error_m", "status"):
        np.testing.assert_array_equal(getattr(found.report, name), getattr(saved.report, name))


CLAIM = npy(np.zeros(2, "<U4")).replace(b"(2,), }" + b" " * 14, b"(1" + b"0" * 14 + b",), }")
EVIL = {
    "bytes as names": ("names", npy(np.zeros(60, "S1"))),
    "a claim of the header's": ("names", CLAIM),
    "more names than markers have": ("names", npy(np.zeros(5001, "<U1"))),
    "a name of megabytes": ("names", npy(np.zeros(1, "<U1000000"))),
    "empty names without end": ("unknown", npy(np.zeros(10**6, "<U0"))),
    "a pickle": ("names", npy(np.array([{}], object))),
    "texts as angles": ("angles_rad", npy(np.zeros((5, N_JOINTS, 3), "<U1"))),
    "fewer numbers than claimed": ("pelvis_m", npy(np.zeros((5, 3)))[:-8]),
    "two legs": ("leg_m", npy(np.zeros(2))),
    "nothing": ("status", b""),
}


@pytest.mark.parametrize("case", EVIL)
def test_an_evil_array_is_refused(tmp_path, case):
    with pytest.raises(FormatError, match=r"m\.npz") as error:
        load_motion(spoilt(tmp_path / "m.npz", *EVIL[case]))
    assert "\n" not in str(error.value)


def test_other_packings_are_refused(tmp_path):
    with pytest.raises(FormatError, match="packed by method 14"):
        load_motion(spoilt(tmp_path / "m.npz", "leg_m", npy(np.array(1.0)), zipfile.ZIP_LZMA))


def test_a_spoilt_stream_is_refused(tmp_path):
    path = spoilt(tmp_path / "m.npz", "names", npy(np.zeros(4000, "<U9")))
    with zipfile.ZipFile(path) as archive:
        at = archive.getinfo("names.npy").header_offset + 30 + len("names.npy")
    data = bytearray(path.read_bytes())
    data[at : at + 20] = b"\xff" * 20
    path.write_bytes(data)
    with pytest.raises(FormatError, match="cannot be read"):
        load_motion(path)


@pytest.mark.parametrize(
    ("bound", "value", "why"),
    [
        ("MAX_BYTES", 5000, "unpacks to more"),
        ("MAX_BYTES", 200, "is larger"),
        ("MAX_DIRECTORY_BYTES", 400, "lists too many members"),
    ],
)
def test_sizes_are_bounded_before_anything_is_unpacked(tmp_path, monkeypatch, bound, value, why):
    save_motion(tmp_path / "m.npz", motion(40))
    monkeypatch.setattr(plain_arrays, bound, value)
    monkeypatch.setattr(plain_arrays, "_array", None)
    if why == "unpacks to more":
        spoilt(tmp_path / "m.npz", "error_m", bytes(10_000))
    with pytest.raises(FormatError, match=why):
        load_motion(tmp_path / "m.npz")


def test_small_numbers_count_as_the_wide_ones_they_become(tmp_path, monkeypatch):
    path = spoilt(tmp_path / "m.npz", "angles_rad", npy(np.zeros((200, N_JOINTS, 3), np.uint8)))
    monkeypatch.setattr(plain_arrays, "MAX_BYTES", 8 * 200 * N_JOINTS)
    with pytest.raises(FormatError, match="numbers; cut the recording"):
        load_motion(path)


@pytest.mark.parametrize("tail", [b"x", b"PK\6\7" + bytes(16)])
def test_an_archive_that_hides_its_list_is_refused(tmp_path, tail):
    save_motion(tmp_path / "m.npz", motion())
    data = (tmp_path / "m.npz").read_bytes()
    cut = len(data) - (22 if len(tail) > 1 else 0)
    (tmp_path / "m.npz").write_bytes(data[:cut] + tail + data[cut:])
    with pytest.raises(FormatError, match="not an archive of arrays"):
        load_motion(tmp_path / "m.npz")
