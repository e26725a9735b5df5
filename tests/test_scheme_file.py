"""Scheme files survive being written; each wrong file is refused in one line; the verbs of ``scheme``."""

import json
import re
import tempfile
from dataclasses import replace
from pathlib import Path

import pytest
from conftest import tree
from hypothesis import given, settings
from hypothesis import strategies as st

from annotate.scheme.merging import converts
from annotate.scheme.scheme_file import (
    MAX_TOML_BYTES,
    SHIPPED,
    faults_in,
    load_scheme,
    read_draft,
    read_scheme,
    scheme_to_toml,
)
from sensors.errors import FormatError
from tests.helpers.schemes import schemes

ROOT = Path(__file__).parent.parent
PAPER = scheme_to_toml(replace(load_scheme("paper"), name="ours"))
TITLES = st.text(max_size=100).filter(str.isprintable) | st.sampled_from(
    ['"]\nid = 3'[:2], "a\\b", "'''", "Ä"]
)


@given(schemes(colored=True), TITLES, st.sampled_from(["", "heading", "two\n[[lines]]"]))
@settings(deadline=None, max_examples=25)
def test_a_file_survives_being_written(scheme, title, heading):
    first = replace(scheme.parts[0], title=title)
    scheme = replace(scheme, parts=(first, *scheme.parts[1:]))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scheme.toml"
        path.write_text(scheme_to_toml(scheme, heading), encoding="utf-8")
        assert read_scheme(path) == scheme and faults_in(path) == []
        assert load_scheme(path) == load_scheme(str(path)) == scheme


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_file_reads_like_any_other(tmp_path, name):
    path = tmp_path / "x.toml"
    path.write_text(scheme_to_toml(load_scheme(name)))
    assert read_scheme(path) == load_scheme(name)


def test_title_and_name_have_defaults(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(
        re.sub("(title|name) = .*\n", "", PAPER, count=2).replace("[[parts]]", '[[parts]]\nname = "head"', 1)
    )
    scheme = read_draft(path).scheme
    assert scheme.name == "mine" and scheme.parts[0].title == "Head"


def to(old: str, new: str, text: str = PAPER) -> str:
    """Return the paper's scheme, or another, with its first ``old`` replaced."""
    assert old in text
    return text.replace(old, new, 1)


def with_part(number: int, name: str, color: str = "") -> str:
    return f'{PAPER}\n[[parts]]\nid = {number}\nname = "{name}"\n{color}\n'


ARM, OTHER_ARM = '["left_upper_arm"]', '["right_upper_arm"]'
WRONG = {
    "twice the same region": (
        to('"neck"', '"neck", "chest"'),
        "region chest is in parts 'head' and 'torso'; leave it in one of them",
    ),
    "region twice in one part": (to('"neck"', '"head"'), "part 'head' has a region twice; name it once"),
    "unknown region": (to('"neck"', '"throat"'), "part 'head' has the unknown region 'throat'; use head,"),
    "region in no part": (to(', "neck"', ""), "regions in no part: neck; add them to"),
    "twin missing": (
        to(OTHER_ARM, "[]", to('"chest"', '"chest", "right_upper_arm"')),
        "part 'torso' has no twin; give one part exactly the mirrored regions: chest, belly,",
    ),
    "not mirrored": (
        to(ARM, '["left_upper_arm", "left_hand"]', to('"left_hand", ', "")),
        "part 'left_upper_arm' has no twin; give",
    ),
    "sides mixed up": (
        to(ARM, OTHER_ARM, to(OTHER_ARM, ARM)),
        "part 'left_upper_arm' has right_upper_arm; give it regions of the left side",
    ),
    "300 parts": (
        "".join(f'[[parts]]\nid = {i}\nname = "p{i}"\n' for i in range(300)),
        "the scheme has 300 parts; give at most 254",
    ),
    "no parts": ('name = "ours"', "the scheme has no parts; add"),
    "parts are numbers": ("parts = [1, 2]", "the scheme has no parts; add"),
    "same colour": (
        to("#425fa7", "#e33945"),
        "'head' and 'torso' have the same colour #e33945; run annotate-cloud scheme colours AT",
    ),
    "near colour": (
        to("#425fa7", "#e83945"),
        "'head' and 'torso' are 1.2 apart in colour for protan eyes (CIE 1976; at least 23); "
        "run annotate-cloud scheme colours AT",
    ),
    "like the background": (to("#425fa7", "#18181c"), "the background and 'torso' have the same colour"),
    "no colour": (
        with_part(12, "bag"),
        "parts without colour: bag; run annotate-cloud scheme colours AT",
    ),
    "wrong colour": (to("#425fa7", "blue"), "part 'torso' has color 'blue'; give '#rrggbb'"),
    "same id": (to("id = 2", "id = 1"), "parts 'head' and 'torso' have the same id 1; give each its own"),
    "same name": (with_part(12, "hip"), "parts 'hip' and 'hip' have the same name 'hip'; give each"),
    "same key": (to('"W"', '"e"'), "parts 'torso' and 'left_forearm' have the same key 'E'; give each"),
    "key of the background": (to('"W"', '"x"'), "part 'torso' has the key of the background, 'x'; give"),
    "id 0": (to("id = 2", "id = 0"), "part 'torso' has id 0; give 1 to 254, because"),
    "id 255": (to("id = 2", "id = 255"), "part 'torso' has id 255; give 1 to 254, because"),
    "id of another type": (to("id = 2", "id = true"), "part 'torso' has id True; give a whole"),
    "no id": (to("id = 2", ""), "part 'torso' has id None; give a whole"),
    "reserved name": (to('"torso"', '"background"'), "a part has the name 'background', which"),
    "wrong name": (to('"torso"', '"the torso"'), "part 2 has name 'the torso'; use a to z"),
    "wrong title": (to('"Torso"', '"a\\nb"'), r"part 'torso' has title 'a\nb'; give a text"),
    "regions are a text": (to('["hip"]', '"hip"'), "part 'hip' has regions 'hip'; give a list"),
    "unknown field of a part": (to("title", "label"), "part 'head' has the unknown field 'label'; use id,"),
    "unknown field": (f"size = 3\n{PAPER}", "the scheme has the unknown field 'size'; use name,"),
    "wrong name of the scheme": (to("ours", "my own"), "the scheme has name 'my own'; use up to"),
    "shipped name": (
        to('"ours"', '"six"'),
        "the scheme has the name of a shipped one, 'six'; give",
    ),
    "twins of no part": (
        f'twins = [["a", "b"]]\n{PAPER}',
        "twins have the unknown part 'a'; use head,",
    ),
    "twins of the body": (f'twins = [["head", "hip"]]\n{PAPER}', "twins have part 'head', whose twin"),
    "twins are names": (f'twins = ["head"]\n{PAPER}', "twins are not a list of pairs; write twins ="),
    "beside itself": (
        f'neighbours = [["hip", "hip"]]\n{PAPER}',
        "neighbours have part 'hip' beside itself; name",
    ),
    "not TOML": ("[[parts", "cannot be read"),
    "too large": (PAPER.ljust(MAX_TOML_BYTES + 1), f"is larger than {MAX_TOML_BYTES} bytes; give"),
}
"""Text of a wrong file, and a piece of its line; AT is the file."""


@pytest.mark.parametrize("fault", WRONG)
def test_a_wrong_file_gets_one_line(tmp_path, annotate_cloud, fault):
    text, says = WRONG[fault]
    path = tmp_path / "ours.toml"
    path.write_text(text)
    with pytest.raises(FormatError) as refused:
        load_scheme(path)
    line = str(refused.value)
    assert says.replace("AT", str(path)) in line and "\n" not in line and str(path) in line
    assert len(line) < 500 and ";" in line
    done = annotate_cloud("scheme", "check", path)
    assert done.code == 1 and line in (done.out + done.err)


def test_all_faults_are_printed_at_once(tmp_path, annotate_cloud):
    path = tmp_path / "ours.toml"
    path.write_text(
        PAPER.replace("id = 2", "id = 1").replace('"W"', '"x"').replace('name = "hip"', 'name = "head"')
    )
    done = annotate_cloud("scheme", "check", path, "--json")
    found = json.loads(done.out)
    assert done.code == 1 and not found["ok"] and len(found["faults"]) == 3


def test_a_file_at_the_bound_is_read(tmp_path):
    path = tmp_path / "ours.toml"
    path.write_text(PAPER.ljust(MAX_TOML_BYTES))
    assert read_scheme(path).name == "ours"


# The verbs


def test_list_and_show_print_all_parts(annotate_cloud):
    listed = json.loads(annotate_cloud("scheme", "list", "--json").out)["schemes"]
    assert [*listed] == [*SHIPPED]
    for name in SHIPPED:
        shown = json.loads(annotate_cloud("scheme", "show", name, "--json").out)
        assert [row["name"] for row in shown["parts"]] == listed[name]
        text = annotate_cloud("scheme", "show", name).out
        assert all(part.name in text for part in load_scheme(name).parts)


def test_the_page_s_own_scheme_with_a_wheelchair(tmp_path, annotate_cloud):
    """The page's steps: a copy, a thing without a colour, a proposal, a check."""
    (table,) = re.findall(r"^```toml\n(.*?)^```", (ROOT / "docs/schemes.md").read_text(), re.M | re.S)
    own, done = tmp_path / "clinic.toml", tmp_path / "clinic-coloured.toml"
    assert annotate_cloud("scheme", "new", own, "--from", "hands-and-feet").code == 0
    with own.open("a") as file:
        file.write(table)
    assert "wheelchair" in annotate_cloud("scheme", "check", own).out
    proposed = annotate_cloud("scheme", "colours", own, "--json")
    assert [*json.loads(proposed.out)["colors"]] == ["wheelchair"] and not done.exists()
    assert annotate_cloud("scheme", "colours", own, "--out", done).code == 0
    assert annotate_cloud("scheme", "check", done).code == 0
    scheme, start = read_scheme(done), load_scheme("hands-and-feet")
    assert scheme.name == "clinic" and converts(scheme, start) and converts(start, scheme)
    assert scheme.parts[:-1] == start.parts and scheme.parts[-1].is_free


@pytest.mark.parametrize(
    "command",
    ["show AT/nowhere", "new AT/taken.toml", "new AT/new.toml --from nowhere", "check AT/nowhere",
     "new AT/my-own-@.toml", "colours AT/taken.toml", "colours AT/good.toml --out AT/taken.toml"],
)  # fmt: skip
def test_refusals_write_nothing(tmp_path, annotate_cloud, command):
    (tmp_path / "taken.toml").write_text("[[parts]]\n")
    (tmp_path / "good.toml").write_text(PAPER)
    before = tree(tmp_path)
    done = annotate_cloud("scheme", *(word.replace("AT", str(tmp_path)) for word in command.split()))
    assert done.code == 1 and len(done.err.splitlines()) == 1 and tree(tmp_path) == before
