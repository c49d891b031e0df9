"""The Merkle Tree Hash against RFC 6962's definition, and roots that its authors publish."""

from hashlib import sha256

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nw_gate.results.evidence import leaf_hash, root_of

# Entries and roots of the test data in the reference implementation of Certificate Transparency
# (merkletree/merkle_tree_test.cc): the tree of the first n entries, for n = 1 to 8.
ENTRIES = [
    bytes.fromhex(entry)
    for entry in (
        "",
        "00",
        "10",
        "2021",
        "3031",
        "40414243",
        "5051525354555657",
        "606162636465666768696a6b6c6d6e6f",
    )
]
ROOTS = [
    "6e340b9cffb37a989ca544e6bb780a2c78901d3fb33738768511a30617afa01d",
    "fac54203e7cc696cf0dfcb42c92a1d9dbaf70ad9e621f4bd8d98662f00e3c125",
    "aeb6bcfe274b70a14fb067a5e5578264db0fa9b51af5e0ba159158f329e06e77",
    "d37ee418976dd95753c1c73862b9398fa2a2cf9b4ff0fdfe8b30cd95209614b7",
    "4e3bbb1f7b478dcfe71fb631631519a3bca12c9aefca1612bfce4c13a86264d4",
    "76e67dadbcdf1e10e1b74ddc608abd2f98dfb16fbce75277b5232a127f2087ef",
    "ddb89be403809e325750d3d263cd78929c2942b7942a34b77e122c9594a74c8c",
    "5dc9da79a70659a9ad559cb701ded9a2ab9d823aad2f4960cfe370eff4604328",
]

entries = st.lists(st.binary(max_size=70), max_size=40)


def root(listed):
    return root_of(map(leaf_hash, listed))


def defined(listed):
    """The definition, word for word, which takes apart what the code puts together."""
    if not listed:
        return sha256(b"").digest()
    if len(listed) == 1:
        return sha256(b"\x00" + listed[0]).digest()
    k = 1
    while 2 * k < len(listed):
        k *= 2
    return sha256(b"\x01" + defined(listed[:k]) + defined(listed[k:])).digest()


@pytest.mark.parametrize("count", range(1, 9))
def test_its_roots_are_the_published_ones(count):
    assert root(ENTRIES[:count]).hex() == ROOTS[count - 1]


def test_the_root_of_nothing_is_the_hash_of_nothing():
    assert root([]).hex() == sha256().hexdigest()


@given(entries)
def test_it_is_the_definition(listed):
    assert root(listed) == defined(listed)


@given(entries, st.data())
def test_no_entry_is_changed_left_out_repeated_or_exchanged_without_another_root(listed, data):
    listed = [*listed, b"last"]
    place = data.draw(st.integers(0, len(listed) - 1))
    others = [
        [*listed[:place], listed[place] + b"\0", *listed[place + 1 :]],
        [*listed[:place], *listed[place + 1 :]],
        [*listed[: place + 1], *listed[place:]],
    ]
    turned = list(reversed(listed))
    others += [turned] if turned != listed else []
    assert root(listed) not in {root(other) for other in others}


@given(st.lists(st.binary(max_size=70), min_size=2, max_size=40))
def test_no_list_whose_entries_are_nodes_of_another_has_its_root(listed):
    """The second preimage that a tree without distinct first bytes falls for."""
    k = 1
    while 2 * k < len(listed):
        k *= 2
    halves = defined(listed[:k]) + defined(listed[k:])
    assert root([halves]) != root(listed)
    assert root([defined(listed[:k]), defined(listed[k:])]) != root(listed)
    assert root([b"\x01" + halves]) != root(listed)
