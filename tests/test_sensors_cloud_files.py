"""Cloud files of other programs are read in every variant, or refused in one line."""

import warnings
from itertools import product

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sensors.errors import CloudError, FormatError
from sensors.importers.clouds import pcd_file
from sensors.importers.clouds.pcd_file import read_pcd
from sensors.importers.clouds.ply_file import read_ply
from sensors.importers.open_source import open_source
from sensors.rig.camera import unproject
from tests.helpers.cloud_files import (
    assert_is_the_room,
    camera_points,
    colored_pcd,
    finite,
    pcd,
    ply,
    random_colors,
    room,
)
from tests.helpers.depth_files import CAMERA, assert_refused, write

law = settings(deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
DEPTH = np.random.default_rng(0).integers(500, 4500, (24, 32)).astype(np.uint16)
DEPTH[::5, ::3] = 0
GRID = unproject(CAMERA, np.where(DEPTH > 0, DEPTH / 1000, np.nan).astype(np.float32))
"""Organised cloud (24, 32, 3) of the depth image."""
TEXT = "\n".join(" ".join(f"{number:.6f}" for number in point) for point in GRID.reshape(-1, 3)).encode()


def fields(names: str, sizes: str, types: str, counts: str) -> dict[str, str]:
    return {"FIELDS": names, "SIZE": sizes, "TYPE": types, "COUNT": counts}


def without(line: bytes):
    return lambda content: content.replace(line, b"")


HEADERS = {
    "umlauts": lambda content: b"# Punktwolke f\xc3\xbcr M.\n" + content,
    "latin-1": lambda content: b"# Punktwolke f\xfcr M.\n" + content,
    "columns": lambda content: content.replace(b"FIELDS", b"COLUMNS").replace(b"0.7", b".5"),
    "no points": without(b"POINTS 768\n"),
    "no count": without(b"COUNT 1 1 1\n"),
    "no size or type": without(b"SIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"),
    "no viewpoint": without(b"VIEWPOINT 0 0 0 1 0 0 0\n"),
    "capitals": lambda content: content.replace(b"DATA binary", b"DATA BINARY"),
    "carriage returns": lambda content: (
        content[: content.index(b"DATA")].replace(b"\n", b"\r\n")
        + content[content.index(b"DATA") :].replace(b"binary\n", b"binary\r\n", 1)
    ),
    "text": lambda _: pcd(GRID, 32, 24, TEXT, DATA="ascii"),
    "text in capitals": lambda _: pcd(GRID, 32, 24, TEXT, DATA="ASCII"),
}


@pytest.mark.parametrize("name", HEADERS)
def test_pcd_variants_that_pcl_accepts_are_read(tmp_path, name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        source = open_source(write(tmp_path / "x.pcd", HEADERS[name](pcd(GRID, 32, 24))))
    np.testing.assert_array_equal(source.frame(0).depth_mm, DEPTH)


def test_padding_of_pcl_is_skipped(tmp_path):
    """PointXYZRGB as PCL writes it (isl-org/Open3D#6437): two fields called "_", other fields counted."""
    layout = [("xyz", "<f4", 3), ("a", "u1", 4), ("rgb", "<u4"), ("b", "u1", 12), ("h", "<f4", 5)]
    records = np.zeros(GRID.size // 3, layout)
    records["xyz"], records["a"], records["b"] = GRID.reshape(-1, 3), 255, 255
    records["rgb"] = np.arange(len(records)) % 200 + 1
    header = fields("x y z _ rgb _ h", "4 4 4 1 4 1 4", "F F F U F U F", "1 1 1 4 1 12 5")
    values = {name: records[name] for name in records.dtype.names} | {
        "rgb": np.ascontiguousarray(records["rgb"]).view("<f4")
    }
    rows = np.column_stack([column.reshape(len(records), -1) for column in values.values()])
    text = "\n".join(" ".join(f"{number:.9g}" for number in row) for row in rows).encode()
    for data, content in (("binary", records.tobytes()), ("ascii", text)):
        source = open_source(write(tmp_path / "x.pcd", pcd(GRID, 32, 24, content, DATA=data, **header)))
        np.testing.assert_array_equal(source.frame(0).depth_mm, DEPTH)
        expected = np.where(DEPTH > 0, records["rgb"].reshape(24, 32), 0)
        np.testing.assert_array_equal(source.frame(0).decode_color()[..., 2], expected)


PACKED = {"float": {}, "unsigned": {"TYPE": "F F F U"}, "rgba": {"FIELDS": "x y z rgba", "TYPE": "F F F U"}}


@pytest.mark.parametrize("kind", [*PACKED, "text", "ply", "ply in capitals"])
def test_colours_are_found(tmp_path, kind):
    points = finite(camera_points(room())).astype(np.float32)
    colors = random_colors(len(points))
    if kind == "text":
        red, green, blue = colors.astype(np.uint32).T
        packed = (red << 16 | green << 8 | blue).view(np.float32)
        lines = (f"{x:.9g} {y:.9g} {z:.9g} {c:.9g}" for (x, y, z), c in zip(points, packed, strict=True))
        header = fields("x y z rgb", "4 4 4 4", "F F F F", "1 1 1 1")
        content = pcd(points, len(points), 1, "\n".join(lines).encode(), DATA="ascii", **header)
    elif kind in PACKED:
        content = colored_pcd(points, colors, **PACKED[kind])
    else:
        content = ply(points, colors)
        for name in (b"red", b"green", b"blue") if "capitals" in kind else ():
            content = content.replace(b" " + name + b"\n", b" " + name.capitalize() + b"\n")
    suffix = "ply" if kind.startswith("ply") else "pcd"
    assert_is_the_room(open_source(write(tmp_path / f"x.{suffix}", content)), room(), colors)


@pytest.mark.parametrize("bits", [8, 16])
def test_colours_of_las_have_8_or_16_bits(tmp_path, bits):
    laspy = pytest.importorskip("laspy")
    points = finite(camera_points(room()))
    colors = random_colors(len(points))
    header = laspy.LasHeader(point_format=2, version="1.2")
    header.scales = np.full(3, 1e-6)
    cloud = laspy.LasData(header)
    cloud.xyz = points
    cloud.red, cloud.green, cloud.blue = colors.astype(np.uint16).T * (257 if bits == 16 else 1)
    cloud.write(str(tmp_path / "x.las"))
    assert_is_the_room(open_source(tmp_path / "x.las"), room(), colors)


def test_meshes_and_splats_give_their_points_and_a_note(tmp_path):
    points = finite(camera_points(room()))
    face = b"\x03" + np.array([0, 1, 2], "<i4").tobytes()
    faces = "element face 2\nproperty list uchar int vertex_indices\n"
    before = ply(points, extra=faces).replace(b"end_header\n", b"end_header\n" + face * 2)
    after = ply(points).replace(b"end_header", faces.encode() + b"end_header") + face * 2
    for content in (before, after):
        source = open_source(write(tmp_path / "x.ply", content))
        assert_is_the_room(source, room())
        assert "a mesh: of its 2 faces only the corners are read" in source.notes
    splats = ply(points, random_colors(len(points)))
    for name, field in ((b"red", b"opacity"), (b"green", b"scale_0"), (b"blue", b"rot_0")):
        splats = splats.replace(b" " + name + b"\n", b" " + field + b"\n")
    notes = open_source(write(tmp_path / "y.ply", splats)).notes
    assert "Gaussian splats: only their centres are read, without colours" in notes


def test_lists_of_any_length_are_passed_over(tmp_path):
    points = np.random.default_rng(0).uniform(1, 2, (5, 3))
    names = (
        "".join(f"property double {axis}\n" for axis in "xyz") + "property list uchar short k\nend_header\n"
    )
    for order, kind in (("<", "binary_little_endian"), (">", "binary_big_endian"), ("", "ascii")):
        head = f"ply\nformat {kind} 1.0\nelement vertex 5\n{names}".encode()
        rows = b""
        for number, point in zip((1, 1, 3, 0, 4), points, strict=True):
            if order:
                extra = np.arange(number, dtype=f"{order}i2").tobytes()
                rows += point.astype(f"{order}f8").tobytes() + bytes([number]) + extra
            else:
                rows += f"{' '.join(map(repr, point.tolist()))} {number} {'7 ' * number}\n".encode()
        np.testing.assert_array_equal(read_ply(write(tmp_path / "x.ply", head + rows)).points(), points)
        with pytest.raises(FormatError):
            read_ply(write(tmp_path / "x.ply", head + rows[: -1 if order else -20]))


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_a_ply_that_is_cut_off_is_refused(tmp_path, kind):
    points = np.random.default_rng(0).uniform(1, 2, (500, 6))
    names = "".join(f"property float {a}\n" for a in ("x", "y", "z", "nx", "ny", "nz"))
    head = f"ply\nformat {kind} 1.0\nelement vertex 500\n{names}end_header\n".encode()
    text = "\n".join(" ".join(f"{x:.6f}" for x in p) for p in points)
    body = text.encode() if kind == "ascii" else points.astype("<f4" if "little" in kind else ">f4").tobytes()
    path = write(tmp_path / "x.ply", head + body)
    np.testing.assert_allclose(read_ply(path).points(), points[:, :3], atol=1e-6)
    for cut in (9, len(body) // 3):
        assert_refused(write(path, head + body[: -cut - 1]), "500", FormatError)


def test_open3d_writes_what_is_read_and_damage_is_refused(tmp_path):
    o3d = pytest.importorskip("open3d")
    flat = GRID.reshape(-1, 3)
    cloud = o3d.t.geometry.PointCloud(flat)
    cloud.point.colors = o3d.core.Tensor(random_colors(len(flat)))
    for suffix, options in product(("ply", "pcd"), ({}, {"write_ascii": True}, {"compressed": True})):
        path = tmp_path / f"x.{suffix}"
        o3d.t.io.write_point_cloud(str(path), cloud, **options)
        found = (read_pcd if suffix == "pcd" else read_ply)(path)
        np.testing.assert_allclose(found.points(), flat, atol=1e-5)
        np.testing.assert_array_equal(found.colors(), cloud.point.colors.numpy())
    content = path.read_bytes()  # compressed
    assert_refused(write(path, content[:-1000]), "is cut off", FormatError)
    rng, at = np.random.default_rng(0), content.index(b"compressed\n") + 19
    for _ in range(25):
        spoilt = bytearray(content)
        spoilt[rng.integers(at, len(content))] ^= rng.integers(1, 256)
        try:
            read_pcd(write(path, bytes(spoilt)))
        except FormatError as error:
            assert "\n" not in str(error)


def test_clouds_are_read_up_to_their_bound(tmp_path, monkeypatch):
    path = write(tmp_path / "x.pcd", pcd(GRID, 32, 24))
    monkeypatch.setattr(pcd_file, "MAX_POINTS", 32 * 24)
    assert read_pcd(path).grid == (24, 32)
    monkeypatch.setattr(pcd_file, "MAX_POINTS", 32 * 24 - 1)
    with pytest.raises(FormatError, match="768 points; 1 to 767 are read"):
        read_pcd(path)


BROKEN = {
    "empty": b"",
    "no header's end": b"VERSION 0.7\nFIELDS x y z",
    "too many points": pcd(GRID, 10**5, 10**4),
    "more points than bytes": pcd(GRID, 33, 24),
    "sizes contradict": pcd(GRID, 32, 24, POINTS="7"),
    "negative": pcd(GRID, -32, -24),
    "no points": pcd(GRID[:0], 0, 1),
    "text as size": pcd(GRID, 32, 24, SIZE="4 4 x"),
    "odd fields": pcd(GRID, 32, 24, FIELDS="x y"),
    "no z": pcd(GRID, 32, 24, FIELDS="x y w"),
    "integers": pcd(GRID, 32, 24, TYPE="I I I"),
    "huge count": pcd(GRID, 32, 24, COUNT="1 1 999999999"),
    "bomb": pcd(GRID, 32, 24, DATA="binary_compressed"),
    "unknown data": pcd(GRID, 32, 24, DATA="../../etc/passwd"),
    "words among numbers": pcd(GRID, 32, 24, TEXT.replace(b"nan", b"none", 1), DATA="ascii"),
    "all NaN": pcd(GRID * np.nan, 32, 24),
    "no image": pcd(np.random.default_rng(0).uniform(1, 2, (24, 32, 3)), 32, 24),
    "long line": b"#" * 10_000,
    "many lines": b"# x\n" * 10_000,
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_clouds_are_refused(tmp_path, name):
    assert_refused(write(tmp_path / "x.pcd", BROKEN[name]), kind=FormatError)


@given(data=st.data())
@law
def test_a_flipped_cloud_is_an_error_or_a_frame(tmp_path, data):
    suffix, content = data.draw(st.sampled_from([("pcd", pcd(GRID, 32, 24)), ("ply", ply(finite(GRID)))]))
    spoilt = bytearray(content)
    for _ in range(data.draw(st.integers(1, 3))):
        spoilt[data.draw(st.integers(0, 250))] = data.draw(st.integers(0, 255))
    path = write(tmp_path / f"x.{suffix}", bytes(spoilt))
    try:
        frames = list(open_source(path))
    except CloudError as error:
        assert "\n" not in str(error)
    else:
        assert len(frames) == 1


@pytest.mark.parametrize(
    "name",
    [
        "pcd_padding_twice.pcd",
        "pcd_utf8_comment.pcd",
        "pcd_viewpoint_world_unorganised.pcd",
        "ply_millimetres.ply",
    ],
)
def test_files_of_others_are_read(shared_data, name):
    depth = open_source(shared_data / "others_files" / name).frame(0).depth_mm
    assert np.count_nonzero(depth) == 48 * 64 and 1700 <= depth[depth > 0].min() < depth.max() <= 2300
