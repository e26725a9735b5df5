"""Messages quote what files say: whatever that is, one line that a terminal only shows."""

from hypothesis import given
from hypothesis import strategies as st

from sensors.errors import LONGEST, FormatError, one_line


@given(st.text())
def test_any_text_is_one_harmless_line(text):
    line = str(FormatError(text))
    assert line.isprintable() and len(line.splitlines()) <= 1
    line.encode()
    assert one_line(line) == line


@given(st.text(st.characters(categories=["L", "N", "P", "S"])))
def test_what_is_harmless_stays(text):
    assert str(FormatError(text)) == text


@given(st.text(), st.integers(1, 10**4))
def test_however_much_is_quoted_the_beginning_and_the_remedy_stay(text, times):
    line = str(FormatError(f"it is {text * times}; give another"))
    assert len(line) <= 10 * LONGEST and line.startswith("it is ") and line.endswith("; give another")


def test_what_steers_a_terminal_can_be_read():
    assert str(FormatError("id '\x1b[2J\u202e'\nx")) == "id '\\x1b[2J\\u202e' x"
