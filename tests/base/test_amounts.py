"""Amounts of memory: what people write, and what sentences say."""

import pytest

from nw_base.plural import bytes_of, in_words


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("2GB", 2 * 10**9),
        ("1.5 GiB", 3 * 2**29),
        ("500mb", 500 * 10**6),
        (" 64 KiB ", 2**16),
        ("1TB", 10**12),
    ],
)
def test_an_amount_has_a_number_and_a_unit(text, count):
    assert bytes_of(text) == count


@pytest.mark.parametrize(
    "text", ["", "2", "GB", "-1GB", "0GB", "0.0001kB", "2 G", "1e3MB", "nanGB", "٣GB", "9" * 400]
)
def test_whatever_else_is_refused_with_an_example(text):
    with pytest.raises(ValueError, match="such as 2GB"):
        bytes_of(text)


def test_a_sentence_rounds_to_hundredths():
    words = [in_words(count) for count in (2 * 10**9, 2_306_000_000, 512_345_678, 3 * 10**12)]
    assert words == ["2 GB", "2.31 GB", "512.35 MB", "3000 GB"]
    assert [in_words(count) for count in (999_000, 345, 0)] == ["999 kB", "0.34 kB", "0 kB"]
