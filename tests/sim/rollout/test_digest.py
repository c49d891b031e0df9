"""Chained digests."""

from hashlib import sha256

import numpy as np

from nw_sim.rollout.episode import ChainDigest


def test_a_digest_saved_in_the_middle_continues_to_the_same_end():
    whole = ChainDigest()
    for k in range(10):
        whole.update(np.array([k, 0.5]))
    half = ChainDigest()
    for k in range(5):
        half.update(np.array([k, 0.5]))
    rest = ChainDigest()
    rest.restore(half.state())
    for k in range(5, 10):
        rest.update(np.array([k, 0.5]))
    assert rest.hex == whole.hex


def test_one_step_is_the_sha256_of_the_zero_digest_and_the_bytes():
    digest = ChainDigest()
    digest.update(np.array([1.0]), np.array([2.0]))
    assert digest.state() == sha256(bytes(32) + np.array([1.0, 2.0], "<f8").tobytes()).digest()


def test_one_bit_changes_the_digest():
    one, two = ChainDigest(), ChainDigest()
    one.update(np.array([1.0]))
    two.update(np.array([np.nextafter(1.0, 2.0)]))
    assert one.hex != two.hex
