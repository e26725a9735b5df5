"""Labels and exports hold no name of a person unless it was asked for."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from annotate.exchange.formats import FORMATS
from annotate.labelset.label_set import LabelSet
from annotate.labelset.nameless import person_code
from tests.helpers.label_sets import CAMERA, blocks, make

NAME = "Anna Muster"


@given(st.lists(st.text(max_size=9), unique=True, max_size=9))
def test_people_keep_apart_and_a_code_stays(names):
    codes = [person_code(name) for name in names]
    assert len(set(codes)) == len(names) and [person_code(code) for code in codes] == codes


@pytest.mark.parametrize("name", FORMATS)
def test_an_export_holds_no_name_unless_asked(annotate_cloud, tmp_path, name):
    labels = make(tmp_path / "labels", CAMERA, [replace(blocks(), subject=NAME, notes={"who": NAME})])
    for words, expected in (((), person_code(NAME)), (("--names",), NAME)):
        out, back = (tmp_path / f"{end}{len(words)}" for end in ("out", "back"))
        assert annotate_cloud("export", labels.path, out, "--format", name, *words).code == 0
        held = any(NAME.encode() in file.read_bytes() for file in out.rglob("*") if file.is_file())
        assert held <= bool(words)
        assert annotate_cloud("import", out, back).code == 0
        assert {one.subject for one in LabelSet.open(back)} == {expected}
