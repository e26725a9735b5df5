"""Shards, manifest and page: written data comes back, and broken data is named."""

import io
import json
import re
import tarfile
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annotate.frame_labels import FrameLabels
from annotate.labelset.dataset import (
    MANIFEST,
    SCHEMA,
    Dataset,
    encode_shard,
    entries_of,
    read_shard,
    sha256,
    validate,
)
from annotate.labelset.images import decode_parts, encode_parts, encode_png
from sensors.errors import FormatError
from synth.images.dataset_page import contact_sheet, render, statistics_of, write_page
from synth.images.presets import PRESETS, sample

FRAMES = [sample(PRESETS["sitting-train"], 0, i * 16) for i in range(6)]
INFO = {
    "preset": "sitting-train",
    "images": 6,
    "seed": 0,
    "occluders": 0.0,
    "cut": 0.0,
    "versions": {"x": "1"},
}


def tar_of(path, entries, mode="w"):
    """Write a tar of these names and bytes, or add them to one."""
    with tarfile.open(path, mode) as tar:
        for name, data in entries.items():
            member = tarfile.TarInfo(name)
            member.size = len(data)
            tar.addfile(member, io.BytesIO(data))


@pytest.fixture
def dataset(tmp_path):
    """Two shards of three frames, with their manifest."""
    shards = []
    for i in range(2):
        path = tmp_path / f"shard-{i:06d}.tar"
        path.write_bytes(encode_shard(FRAMES[3 * i : 3 * i + 3]))
        shards.append({"file": path.name, "sha256": sha256(path)})
    (tmp_path / MANIFEST).write_text(json.dumps({"schema": SCHEMA, **INFO, "shards": shards}))
    return Dataset.open(tmp_path)


def test_a_dataset_comes_back_as_it_was(dataset):
    assert len(dataset) == 6 and validate(dataset) == []
    for frame, again in zip(FRAMES, dataset, strict=True):
        np.testing.assert_array_equal(again.depth_mm, frame.depth_mm)
        np.testing.assert_array_equal(again.parts, frame.parts)
        assert (again.frame_id, again.subject, again.status) == (frame.frame_id, frame.subject, "truth")
        assert again.notes == frame.notes


@given(seed=st.integers(0, 10_000), height=st.integers(1, 40), width=st.integers(1, 40))
@settings(max_examples=30, deadline=None)
def test_any_frame_survives_a_shard(tmp_path_factory, seed, height, width):
    rng = np.random.default_rng(seed)
    depth = rng.integers(0, 65536, (height, width)).astype(np.uint16)
    parts = rng.choice([*range(12), 255], (height, width)).astype(np.uint8)
    path = tmp_path_factory.mktemp("any") / "s.tar"
    path.write_bytes(encode_shard([FrameLabels("k", depth, parts)]))
    (again,) = read_shard(path)
    np.testing.assert_array_equal(again.depth_mm, depth)
    np.testing.assert_array_equal(again.parts, parts)


def test_parts_are_palette_pngs_and_both_images_small():
    data = encode_parts(FRAMES[0].parts)
    assert data[25] == 3  # colour type: palette
    np.testing.assert_array_equal(decode_parts(data), FRAMES[0].parts)
    assert len(data) + len(encode_png(FRAMES[0].depth_mm)) < 25_000


@pytest.mark.parametrize("damage", ["flip", "cut", "empty", "foreign"])
def test_validate_names_a_corrupt_shard(dataset, damage):
    path = dataset.path / "shard-000001.tar"
    data = bytearray(path.read_bytes())
    if damage == "flip":
        data[1000] ^= 255
    path.write_bytes(
        {"flip": data, "cut": data[: len(data) // 2], "empty": b"", "foreign": b"hello" * 999}[damage]
    )
    problems = validate(dataset)
    assert problems and all("shard-000001.tar" in p and "\n" not in p for p in problems)
    assert "generate" in problems[0]


@pytest.mark.parametrize(
    "fields", [b"[" * 100_000, b'{"status": "king"}', b"{}", b'{"confidence": 1}', b'{"persons": "x"}', b"[]"]
)
def test_a_frame_says_no_more_than_is_written(tmp_path, fields):
    path = tmp_path / "s.tar"
    images = {"k.depth.png": encode_png(FRAMES[0].depth_mm), "k.parts.png": encode_parts(FRAMES[0].parts)}
    for entries in (
        ({"k.json": fields}, {**images, "k.json": fields}) if fields != b"{}" else ({"k.json": fields},)
    ):
        tar_of(path, entries)
        with pytest.raises(FormatError, match="malformed"):
            list(read_shard(path))
    with tarfile.open(path, "w") as tar:
        member = tarfile.TarInfo("../k.json")
        member.type, member.linkname = tarfile.SYMTYPE, "/etc/passwd"
        tar.addfile(member)
    with pytest.raises(FormatError, match="which is not a file"):
        list(read_shard(path))


@pytest.mark.parametrize("form", [tarfile.PAX_FORMAT, tarfile.GNU_FORMAT])
def test_long_names_of_other_writers_are_read(tmp_path, form):
    path, folder = tmp_path / "s.tar", "ordner-mit-umlaut-ä/" * 9
    with (
        tarfile.open(path, "w", format=form) as tar,
        tarfile.open(fileobj=io.BytesIO(encode_shard(FRAMES[:3]))) as plain,
    ):
        for member in plain.getmembers():
            data = plain.extractfile(member)
            member.name = folder + member.name
            tar.addfile(member, data)
    assert [frame.notes for frame in read_shard(path)] == [frame.notes for frame in FRAMES[:3]]
    entries = list(entries_of(path))
    assert [entry.frame_id for entry in entries] == [folder + frame.frame_id for frame in FRAMES[:3]]
    for entry, frame in zip(entries, FRAMES, strict=False):
        assert next(read_shard(path, entry.offset)).notes == frame.notes


def tar_header(name: str, size: bytes = b"00000000000\0", kind: bytes = b"0") -> bytes:
    """One block of a tar, with a right sum."""
    block = bytearray(512)
    block[: len(name)], block[124:136] = name.encode(), size
    block[156:157], block[257:265] = kind, b"ustar\x0000"
    block[148:156] = b" " * 8
    block[148:156] = b"%06o\0 " % sum(block)
    return bytes(block)


HOSTILE = {
    "a negative size": tar_header("a.depth.png")
    + tar_header("b.png", b"\xff" * 10 + b"\xfe\x00")
    + bytes(1024),
    "an endless size": tar_header("a.json", b"\x80" + b"\xff" * 11) + bytes(1024),
    "headers of headers": tar_header("x", kind=b"x") * 1500 + tar_header("a.json") + bytes(1024),
}


@pytest.mark.parametrize("hostile", HOSTILE)
def test_what_leads_tarfile_astray_is_refused(tmp_path, hostile):
    (tmp_path / "s.tar").write_bytes(HOSTILE[hostile])
    for read in (entries_of, read_shard):
        with pytest.raises(FormatError, match=r"s\.tar"):
            list(read(tmp_path / "s.tar"))


def test_a_shard_is_bounded_as_a_whole_and_image_by_image(dataset, monkeypatch):
    """Just inside the bounds it is read; a header for all files, as git archive writes, does no harm."""
    path = dataset.path / "shard-000000.tar"
    with tarfile.open(path) as tar:
        members = tar.getmembers()
        with tarfile.open(path.with_name("g.tar"), "w", pax_headers={"comment": "x"}) as other:
            for member in members:
                other.addfile(member, tar.extractfile(member))
    for shard in (path, path.with_name("g.tar")):
        for bound, size in (
            ("MAX_SHARD_BYTES", shard.stat().st_size),
            ("MAX_MEMBER_BYTES", max(m.size for m in members)),
        ):
            with monkeypatch.context() as bounded:
                bounded.setattr(f"annotate.labelset.dataset.{bound}", size)
                assert len(list(read_shard(shard))) == len(list(entries_of(shard))) == len(members) // 3
                bounded.setattr(f"annotate.labelset.dataset.{bound}", size - 1)
                for read in (entries_of, read_shard):
                    with pytest.raises(FormatError, match=r"larger than|over \d+"):
                        list(read(shard))


def test_files_that_are_no_frame_s_are_passed_over(tmp_path):
    path = tmp_path / "s.tar"
    path.write_bytes(encode_shard(FRAMES[:1]))
    tar_of(path, {"readme.txt": b"abc", f"{FRAMES[0].frame_id}.rgb.jpg": b"abc"}, "a")
    assert [frame.frame_id for frame in read_shard(path)] == [FRAMES[0].frame_id]


FOREIGN_SHARD = '{"schema": 1, "shards": [{"file": "../x", "sha256": ""}]}'


def test_a_bad_manifest_is_refused(dataset, monkeypatch):
    manifest = dataset.path / MANIFEST
    size = manifest.stat().st_size
    monkeypatch.setattr("annotate.labelset.dataset.MAX_MANIFEST_BYTES", size)
    assert Dataset.open(dataset.path) == dataset
    monkeypatch.setattr("annotate.labelset.dataset.MAX_MANIFEST_BYTES", size - 1)
    with pytest.raises(FormatError, match="larger than"):
        Dataset.open(dataset.path)
    for text in ("", "[]", "{}", '{"schema": 9, "shards": []}', FOREIGN_SHARD):
        manifest.write_text(text)
        with pytest.raises(FormatError):
            Dataset.open(dataset.path)


def test_statistics_by_hand():
    statistics = statistics_of(FRAMES)
    person = sum((f.parts > 0).sum() for f in FRAMES)
    assert statistics.frames == 6 and statistics.pixels.sum() == 6 * 212 * 212
    assert statistics.pixels[1:].sum() == statistics.depth.sum() == person
    assert sum(statistics.activities.values()) == statistics.azimuth.sum() == statistics.height.sum() == 6
    assert statistics.spread_mm[0] == 0 and statistics.spread_mm[1:].min() > 0
    assert statistics.occluded == statistics.cut == 0


def test_the_sheet_shows_labels_above_depth():
    sheet = contact_sheet(FRAMES[:3])
    assert sheet.shape == (2 * 212, 8 * 212, 3)
    labels, depth = sheet[:212, :212], sheet[212:, :212]
    seen = FRAMES[0].parts > 0
    assert (depth[seen] > 0).all() and (depth[~seen] == 0).all()
    assert len(np.unique(labels.reshape(-1, 3), axis=0)) == np.unique(FRAMES[0].parts).size


class Links(HTMLParser):
    """Collects what a page would fetch or run."""

    def __init__(self):
        super().__init__()
        self.fetched, self.tags = [], set()

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        self.fetched += [v for k, v in attrs if k in ("src", "href") and not v.startswith("data:image/")]


def test_the_page_is_one_file_without_scripts_or_requests(dataset):
    """Names are text on it, and real people stand beside the dataset's."""
    write_page(dataset)
    page = (dataset.path / "index.html").read_text()
    links = Links()
    links.feed(page)
    assert links.fetched == [] and "script" not in links.tags and "default-src 'none'" in page
    assert re.search(r"6\s+of them", page) and "Left forearm" in page and "10 to 90 %" not in page
    hostile = "<script>alert(1)</script>"
    marked = replace(dataset, info={**dataset.info, "preset": hostile, "versions": {hostile: hostile}})
    page = render(marked, replace(statistics_of(FRAMES).people, name=hostile))
    assert hostile not in page and "<b>&lt;script&gt;" in page and page.count("<path") == 5 + 12
    assert 'class="beyond"' not in page  # its own people lie within
