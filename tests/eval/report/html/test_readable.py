"""The words of a report read easily, as those of README and of the tutorials do."""

import importlib.util
from pathlib import Path

import pytest

_FILE = Path(__file__).parents[3] / "docs" / "test_readability.py"
_SPEC = importlib.util.spec_from_file_location("readability", _FILE)
assert _SPEC is not None
assert _SPEC.loader is not None
readability = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(readability)


def sentences_of(page):
    """Return the sentences of all paragraphs and reasons of a page."""
    told = [each.text for tag in ("p", "li") for each in page.all(tag) if not each.all("a")]
    sentences = [each for text in told for each in readability.prose(text)]
    return [each for each in sentences if len(readability.words(each)) > 2]


@pytest.mark.parametrize("is_compared", [False, True])
def test_the_words_of_a_report_read_easily(make_page, make_row, read, compared, is_compared):
    rows = [make_row("hurdles/low", index, 4 if index else 1) for index in range(10)]
    page = read(make_page(rows, **({"against": compared} if is_compared else {})))
    sentences = sentences_of(page)
    assert len(sentences) > 10
    assert readability.reading_ease(sentences) >= 55
    assert not [each for each in sentences if len(readability.words(each)) > readability.MOST_WORDS]
