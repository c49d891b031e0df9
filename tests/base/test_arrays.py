"""Arrays survive the journey through bytes, and bytes that are no arrays are refused."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from nw_base.memory import pack, unpack

NUMBERS = st.sampled_from(["<f4", "<f8", ">f8", "<i8", "|u1", "|b1"])
ARRAYS = st.dictionaries(
    st.text(max_size=8),
    hnp.arrays(NUMBERS, hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4)),
    max_size=4,
)


@given(ARRAYS)
def test_arrays_come_back_with_every_bit_and_in_memory_of_their_own(arrays):
    data = pack(arrays)
    back = unpack(data)
    assert list(back) == list(arrays)
    for name, array in arrays.items():
        assert back[name].shape == array.shape
        assert back[name].dtype == array.dtype.newbyteorder("<")
        assert back[name].tobytes() == array.astype(back[name].dtype).tobytes()
        assert back[name].flags.writeable
    assert pack(back) == data


@given(ARRAYS, st.integers(0, 400), st.binary(min_size=1, max_size=3))
def test_damaged_bytes_are_refused_or_take_no_more_memory_than_they_are(arrays, place, noise):
    data = pack(arrays)
    damaged = data[:place] + noise + data[place + len(noise) :]
    try:
        back = unpack(damaged)
    except ValueError:
        return
    assert sum(array.nbytes for array in back.values()) <= len(damaged)


def test_nothing_takes_no_bytes():
    assert pack({}) == b""
    assert unpack(b"") == {}


def test_objects_do_not_travel():
    with pytest.raises(TypeError, match="'a' is of object"):
        pack({"a": np.array([object()])})


@pytest.mark.parametrize(
    ("listed", "reason"),
    [
        ([["a", "<f8", [99999999999]]], "buffer"),
        ([["a", "<f8", [-1]]], "shape"),
        ([["a", "<f8", [10**30]]], "no list of arrays"),
        ([["a", "<f8", [2**62, 4]]], "no list of arrays"),
        ([["a", "|O8", [3]]], "array of"),
        ([["a", "f4,(", [3]]], "array of"),
        ([["a", None, [3]]], "no list of arrays"),
        ([["a", "<f8", ["3"]]], "no list of arrays"),
        ([["a", "<f8", [2]]], "8 bytes are left over"),
        ([["a", "nonsense", [3]]], "array of nonsense"),
        ({"a": 3}, "no list of arrays|values to unpack"),
    ],
)
def test_a_list_that_does_not_fit_the_bytes_is_refused(listed, reason):
    header = json.dumps(listed).encode()
    with pytest.raises(ValueError, match=reason):
        unpack(len(header).to_bytes(4, "little") + header + np.zeros(3).tobytes())
