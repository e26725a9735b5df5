"""Motion files: saved ones come back; small ones with large claims are refused packed."""

import io
import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from cli.main import app
from sensors.errors import ExistsError, FormatError
from sensors.files.npz import array_sizes
from synth.body.skeleton import JOINT_ID, N_JOINTS
from synth.markers import motion_file
from synth.markers.motion_file import MarkerReport, Motion, load_motion, save_motion
from synth.markers.person_fit import bones_of_leg


def motion(frames: int = 5, names: tuple[str, ...] = ("LASI", "größer")) -> Motion:
    rng = np.random.default_rng(0)
    report = MarkerReport(
        names,
        rng.random((frames, len(names))).astype(np.float32),
        rng.integers(0, 5, (frames, len(names))).astype(np.uint8),
        ("unknown",),
    )
    angles, pelvis = rng.random((frames, N_JOINTS, 3)), rng.random((frames, 3))
    return Motion(angles, pelvis, 100.0, bones_of_leg(0.8), report)


def spoilt(path: Path, name: str, content: bytes) -> Path:
    """A motion one of whose arrays has these bytes."""
    save_motion(path, motion(), overwrite=True)
    with zipfile.ZipFile(path) as archive:
        members = {info.filename: archive.read(info) for info in archive.infolist()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
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
    assert found.frames_per_second == saved.frames_per_second
    for name in ("angles_rad", "pelvis_m", "bones_m"):
        np.testing.assert_array_equal(getattr(found, name), getattr(saved, name))
    for name in ("error_m", "status"):
        np.testing.assert_array_equal(getattr(found.report, name), getattr(saved.report, name))
    with pytest.raises(ExistsError):
        save_motion(tmp_path / "m.npz", saved)
    data = (tmp_path / "m.npz").read_bytes()
    for bad in (b"", data[:1000], data[:-200], b"PK" + data[5:]):
        (tmp_path / "m.npz").write_bytes(bad)
        with pytest.raises(FormatError):
            load_motion(tmp_path / "m.npz")
    assert [path.name for path in tmp_path.iterdir()] == ["m.npz"]


def test_a_file_that_knows_only_the_leg_still_loads(tmp_path):
    save_motion(tmp_path / "m.npz", motion())
    arrays = dict(np.load(tmp_path / "m.npz"))
    del arrays["bones_m"]
    np.savez(tmp_path / "old.npz", **arrays, leg_m=np.float64(0.7))
    assert load_motion(tmp_path / "old.npz").leg_m == pytest.approx(0.7)


EVIL = {
    "bytes as names": ("names", npy(np.zeros(60, "S1"))),
    "more names than markers": ("names", npy(np.zeros(5001, "<U1"))),
    "a pickle": ("names", npy(np.array([{}], object))),
    "texts as angles": ("angles_rad", npy(np.zeros((5, N_JOINTS, 3), "<U1"))),
    "narrow numbers, which would grow": ("angles_rad", npy(np.zeros((5, N_JOINTS, 3), np.uint8))),
    "fewer numbers than claimed": ("pelvis_m", npy(np.zeros((5, 3)))[:-8]),
    "two bones": ("bones_m", npy(np.zeros((2, 3)))),
    "another version": ("version", npy(np.int64(2))),
    "nothing": ("status", b""),
}


@pytest.mark.parametrize("case", EVIL)
def test_an_evil_array_is_refused(tmp_path, case):
    with pytest.raises(FormatError, match=r"m\.npz") as error:
        load_motion(spoilt(tmp_path / "m.npz", *EVIL[case]))
    assert "\n" not in str(error.value)


def test_a_motion_is_bounded_by_what_it_unpacks_to(tmp_path, monkeypatch):
    save_motion(tmp_path / "m.npz", motion(40))
    unpacked = sum(array_sizes(tmp_path / "m.npz", "").values())
    monkeypatch.setattr(motion_file, "MAX_BYTES", unpacked)
    assert len(load_motion(tmp_path / "m.npz")) == 40
    monkeypatch.setattr(motion_file, "MAX_BYTES", unpacked - 1)
    with pytest.raises(FormatError, match="unpacks to"):
        load_motion(tmp_path / "m.npz")


def test_info_shows_length_person_and_ranges_of_a_motion(tmp_path):
    saved = motion(40)
    save_motion(tmp_path / "m.npz", saved)
    run = CliRunner().invoke(app, ["info", str(tmp_path / "m.npz"), "--json"])
    shown = json.loads(run.stdout)
    assert (shown["kind"], shown["frames"], shown["seconds"], shown["leg_m"]) == ("motion", 40, 0.4, 0.8)
    knee = np.degrees(saved.angles_rad[:, JOINT_ID["left_knee"], 0])
    assert shown["joints_deg"]["left_knee"]["flexion"] == [round(knee.min(), 1), round(knee.max(), 1)]
    text = CliRunner().invoke(app, ["info", str(tmp_path / "m.npz")]).stdout
    assert "frames: 40" in text and "left_knee" in text
