"""Foreign words: no line break, no escape, no order to a CI runner gets through."""

import unicodedata

from hypothesis import given
from hypothesis import strategies as st

from nw_base.clean import clean


@given(st.text(max_size=300))
def test_whatever_comes_leaves_as_one_visible_line(text):
    line = clean(text)
    assert "\n" not in line
    assert all(unicodedata.category(c) not in {"Cc", "Cf", "Cs", "Zl", "Zp"} for c in line)
    assert not line.lstrip().startswith("::")
    assert "##[" not in line


@given(st.text(max_size=300))
def test_cleaning_twice_changes_nothing_more(text):
    assert clean(clean(text)) == clean(text)


def test_plain_words_stay_as_they_are():
    words = "policy 'Ängström' raised ValueError: torch::jit says 5 by 3, not 14"
    assert clean(words) == words


def test_an_escape_sequence_is_shown_and_not_obeyed():
    assert clean("\x1b[2Jgone") == "\\x1b[2Jgone"


def test_a_line_break_cannot_smuggle_an_order_to_the_first_column():
    assert clean("nice\n::error::owned") == "nice ::error::owned"
    assert clean("  ::add-mask::x") == "\\x3a:add-mask::x"
    assert clean("a ##[error]b") == "a #\\x23[error]b"


def test_a_bidirectional_mark_is_shown():
    assert clean("user\u202egpj.exe") == "user\\u202egpj.exe"


def test_a_text_of_millions_of_characters_is_cut_and_says_so():
    line = clean("x" * 5_000_000)
    assert len(line) < 1100
    assert line.endswith(" ... and 4999000 more characters")


def test_passwords_in_addresses_stay_behind():
    assert clean("no server at ws://bob:p@ss@host:1/x?y=a@b") == "no server at ws://host:1/x?y=a@b"


def test_orders_of_other_ci_runners_lose_their_form():
    assert clean("a ##vso[task.x]") == "a #\\x23vso[task.x]"
