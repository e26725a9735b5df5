"""Files from outside are bounded or refused in one line; JPEGs are mirrored; the code has a digest."""

import io
import os
import sys
import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from sensors.errors import LONGEST, CalibrationError, DeviceError, FormatError, one_line
from sensors.files.atomic import write_bytes
from sensors.files.bounded import read_bounded, read_toml
from sensors.files.jpeg import is_lossless, mirrored_jpeg
from sensors.files.npz import array_sizes, load_arrays
from sensors.importers.declared import turned_color
from sensors.rig.frame import RigFrame
from sensors.rig.turn import Turn
from sensors.versions import code_digest, versions
from synth.images.generate import Order
from synth.images.presets import PRESETS

# Messages


@given(st.text(), st.integers(1, 10**4))
def test_any_text_is_one_harmless_line_that_keeps_its_beginning_and_remedy(text, times):
    line = str(FormatError(f"it is {text * times}; give another"))
    assert line.isprintable() and len(line.splitlines()) == 1 and one_line(line) == line
    line.encode()
    assert len(line) <= 10 * LONGEST and line.startswith("it is ") and line.endswith("; give another")


@given(st.text(st.characters(categories=["L", "N", "P", "S"])))
def test_harmless_text_stays_and_control_characters_are_escaped(text):
    assert str(FormatError(text)) == text
    assert str(FormatError("id '\x1b[2J\u202e'\nx")) == "id '\\x1b[2J\\u202e' x"


# Bounded files


@pytest.mark.parametrize(
    ("name", "limit", "says"),
    [
        ("file", 4, "is larger than 4 bytes"),
        ("absent", 9, "cannot be read (No such file or directory)"),
        ("\0", 9, "null byte"),
        ("pipe", 9, "is not a file"),
        ("endless", 9, "is not a file"),
        ("/proc/version", 9, "is larger than 9 bytes"),
    ],
)
def test_files_are_read_whole_up_to_their_bound(tmp_path, name, limit, says):
    (tmp_path / "file").write_bytes(b"12345")
    (tmp_path / "link").symlink_to("file")
    (tmp_path / "endless").symlink_to("/dev/zero")
    os.mkfifo(tmp_path / "pipe")
    assert read_bounded(tmp_path / "link", 5) == b"12345"
    assert read_bounded(Path("/proc/version")) == Path("/proc/version").read_bytes()
    with pytest.raises(CalibrationError) as error:
        read_bounded(tmp_path / name, limit, "split it", CalibrationError)
    assert says in str(error.value) and str(error.value).endswith("; split it")


def test_bytes_are_on_the_disk_before_the_file_gets_its_name(tmp_path, monkeypatch):
    done, replace = [], Path.replace
    monkeypatch.setattr(os, "fsync", lambda file: done.append(os.fstat(file).st_size))
    monkeypatch.setattr(Path, "replace", lambda path, to: done.append(to.name) or replace(path, to))
    write_bytes(tmp_path / "a", b"four")
    assert done == [4, "a"] and (tmp_path / "a").read_bytes() == b"four"


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


def test_archives_of_other_things_than_arrays_are_refused(tmp_path):
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


GOOD = 'name = "a.b"\n[t."c.d"]\nx = [1.5, 2]\ny = { z = 9223372036854775807 }\n'
MANY_DOTS = f"x = [{', '.join(f'{i}.5' for i in range(150))}]  # {'...' * 50}\n"


@pytest.mark.parametrize("content", [GOOD, MANY_DOTS, f"a{'.a' * 9} = 1\nb = {'[' * 9}{']' * 9}\n"])
def test_a_toml_file_is_read_as_tomllib_does(tmp_path, content):
    (tmp_path / "a.toml").write_text(content)
    assert read_toml(tmp_path / "a.toml", len(content), "mend it") == tomllib.loads(content)


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
def test_other_toml_files_are_refused_in_one_line(tmp_path, content, says):
    (tmp_path / "a.toml").write_bytes(content)
    with pytest.raises(DeviceError, match=rf"a\.toml .*{says}.*; mend it$") as caught:
        read_toml(tmp_path / "a.toml", 25_000, "mend it", DeviceError)
    assert "\n" not in str(caught.value)


# JPEG

SAMPLINGS = [cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]


def decoded(encoded):
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    return cv2.imdecode(np.frombuffer(encoded, np.uint8), flags).astype(int)


def photograph(width, height, seed, sampling=SAMPLINGS[0]):
    noise = np.random.default_rng(seed).integers(0, 256, (height, width, 3)).astype(np.uint8)
    options = [cv2.IMWRITE_JPEG_QUALITY, 90, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, sampling]
    return cv2.imencode(".jpg", cv2.GaussianBlur(noise, (0, 0), 4), options)[1].tobytes()


@given(st.integers(17, 90), st.integers(17, 90), st.integers(0, 99), st.sampled_from(SAMPLINGS))
def test_a_mirrored_jpeg_is_the_image_from_right_to_left(width, height, seed, sampling):
    image = photograph(width, height, seed, sampling)
    np.testing.assert_allclose(decoded(mirrored_jpeg(image)), decoded(image)[:, ::-1], atol=20)


@pytest.mark.skipif(not is_lossless(), reason="libturbojpeg is not installed: apt install libturbojpeg0")
@given(st.integers(1, 6), st.integers(17, 90), st.integers(0, 99))
def test_mirroring_whole_blocks_loses_nothing(blocks, height, seed):
    image = photograph(16 * blocks, height, seed)
    np.testing.assert_array_equal(decoded(mirrored_jpeg(mirrored_jpeg(image))), decoded(image))


@pytest.mark.parametrize("quarters", range(4))
@pytest.mark.parametrize("mirror", [False, True])
def test_an_imported_colour_image_is_turned(quarters, mirror):
    image, turn = photograph(48, 64, quarters), Turn(quarters, mirror)
    np.testing.assert_allclose(decoded(turned_color(image, turn)), turn.image(decoded(image)), atol=20)


@pytest.mark.parametrize("kind", ["JPEG", "PNG"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_an_exif_orientation_turns_nothing(orientation, kind):
    quarter, file = np.zeros((32, 64, 3), np.uint8), io.BytesIO()
    quarter[:16, :32] = (250, 10, 10)
    exif = Image.Exif()
    exif[0x112] = orientation
    Image.fromarray(quarter).save(file, kind, exif=exif)
    found = RigFrame(0, 0, np.zeros((4, 4), np.uint16), file.getvalue()).decode_color()
    assert found.shape == quarter.shape and np.abs(found.astype(int) - quarter).mean() < 3
    if kind == "JPEG":
        mirrored = decoded(mirrored_jpeg(file.getvalue()))[..., ::-1]
        assert mirrored.shape == quarter.shape and np.abs(mirrored - quarter[:, ::-1]).mean() < 3


@pytest.mark.parametrize("data", [b"", b"\xff\xd8\xff", b"no image", photograph(64, 64, 0)[:300]])
def test_other_bytes_stay(data):
    assert mirrored_jpeg(data) == data


# Versions


def test_the_digest_changes_with_code_and_data_alone(tmp_path, monkeypatch):
    folder = tmp_path / "other"
    (folder / "__pycache__").mkdir(parents=True)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    found = []
    for name in ("__init__.py", "table.toml", "__pycache__/table.py", "_compiled.so"):
        (folder / name).write_text("x = 1\n")
        code_digest.cache_clear()
        found.append(code_digest("other"))
    code_digest.cache_clear()
    assert found[0] != found[1] == found[2] == found[3]
    assert Order(PRESETS["sitting-test"], 2, 0).manifest()["versions"]["code"] == code_digest(
        "sensors", "annotate", "synth"
    )


def test_a_package_that_is_absent_has_no_version():
    found = versions(["numpy", "opencv-of-another-name"])
    assert found["opencv-of-another-name"] == "none" != found["numpy"]
