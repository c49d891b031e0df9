"""A checksum at the end of a JSON object: what was changed is noticed before it is believed."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nw_gate.results.seal import seal, unseal

VALUES = st.dictionaries(st.text(max_size=5), st.integers() | st.text(max_size=9), min_size=1)


@given(VALUES, st.sampled_from([None, 2]), st.sampled_from(["", "0123456789abcdef"]))
def test_a_sealed_object_is_json_and_opens_to_what_it_was(values, indent, before):
    text = json.dumps(values, indent=indent)
    sealed, total = seal(text, before)
    assert json.loads(sealed) == {**values, "sum": total}
    body, told = unseal(sealed.encode(), before)
    assert json.loads(body) == values
    assert told == total


@given(VALUES, st.integers(0, 10_000), st.integers(0, 7))
def test_no_flipped_bit_is_read_as_something_else(values, place, bit):
    sealed = bytearray(seal(json.dumps(values))[0].encode())
    sealed[place % len(sealed)] ^= 1 << bit
    try:
        body, _ = unseal(bytes(sealed))
    except ValueError:
        return
    assert json.loads(body) == values, "only a blank before the sum may change unnoticed"


def test_the_sum_covers_what_stood_before():
    sealed, _ = seal('{"a": 1}', "0" * 16)
    with pytest.raises(ValueError, match=r"its checksum is [0-9a-f]{16}, what it holds gives"):
        unseal(sealed.encode(), "1" * 16)


@pytest.mark.parametrize("data", [b"", b"{}", b'{"a":1}\n', b'{"a":1,"sum":"xyz"}\n', b"\0" * 99])
def test_an_object_without_a_sum_is_told(data):
    with pytest.raises(ValueError, match="its checksum is missing"):
        unseal(data)
