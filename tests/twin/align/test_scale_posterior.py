"""Of 100 stated scales 95 are as near as they say, in drawn places whose scale is known."""

import numpy as np
import pytest
from known_truth import LIES

from nw_twin.align.scale import ScaleSource, solve_scale

KINDS = {"tag": 0.01, "length": 0.015, "poses": 0.02, "camera height": 0.06, "positions": None}


def drawn(rng, least, lies):
    """Return the true scale and sources of it, `lies` of which are wrong altogether."""
    true = float(np.exp(rng.uniform(-2, 2)))
    names = rng.permutation(list(KINDS))[: rng.integers(least, len(KINDS) + 1)]
    stretch = rng.normal(0, rng.choice([0.002, 0.01, 0.02]), len(names))  # As a bent map is.
    sources = []
    for index, (name, bent) in enumerate(zip(names, stretch, strict=True)):
        sigma = KINDS[name] or rng.choice([0.01, 0.05, 0.3])
        off = rng.choice(LIES) if index < lies else np.exp(rng.normal(0, sigma) + bent)
        sources.append(ScaleSource(name=name, scale=true * off, sigma=sigma, reason=""))
    return true, sources


def stated(seed, count, least, lies):
    """Return by how much stated scales are off, what they claim, and the share that is stated."""
    rng = np.random.default_rng(seed)
    off, claims = [], []
    for _ in range(count):
        true, sources = drawn(rng, least, lies)
        scale = solve_scale(sources)
        if not scale.disputed:
            off.append(abs(scale.scale / true - 1.0))
            claims.append(scale.within)
    return np.array(off), np.array(claims), len(off) / count


@pytest.mark.parametrize(("least", "lies", "said"), [(1, 0, 0.95), (3, 1, 0.5), (2, 1, 0.3)])
def test_stated_scales_hold_the_truth_also_where_a_source_lies(least, lies, said):
    off, claims, share = stated(7, 400, least, lies)
    assert (off <= claims).mean() >= 0.93
    assert share >= said
    assert np.median(claims) < 0.07  # What is vague everywhere says nothing.


def of(**answers):
    """Return sources by name, with their scale and its standard deviation."""
    return [
        ScaleSource(name=name, scale=scale, sigma=sigma, reason="")
        for name, (scale, sigma) in answers.items()
    ]


def test_sources_that_agree_know_the_scale_better_than_each_alone_and_those_that_scatter_worse():
    alone = solve_scale(of(tag=(2.0, 0.01)))
    assert alone.scale == pytest.approx(2.0, rel=1e-9)
    agreeing = solve_scale(of(tag=(2.0, 0.01), length=(2.01, 0.01), poses=(1.99, 0.02)))
    scattered = solve_scale(of(tag=(2.0, 0.01), length=(2.12, 0.01), poses=(1.9, 0.02)))
    assert agreeing.within < 0.6 * alone.within
    assert scattered.within > 2.0 * agreeing.within


def test_of_two_sources_that_contradict_each_other_neither_is_believed_and_a_third_decides():
    two = {"tag": (1.0, 0.01), "positions": (1.25, 0.02)}
    assert solve_scale(of(**two)).disputed == (0, 1)
    three = solve_scale(of(**two, length=(1.01, 0.015)))
    assert three.disputed == ()
    assert three.wrong == (1,)
    assert three.scale == pytest.approx(1.005, abs=0.01)
    vague = solve_scale(of(tag=(1.0, 0.01), positions=(1.6, 0.3)))  # It says little, and it may.
    assert vague.disputed == vague.wrong == ()


def test_the_same_sources_in_another_unit_give_the_same_length():
    sources = {"tag": (1.0, 0.01), "length": (1.04, 0.02), "positions": (0.8, 0.2)}
    one = solve_scale(of(**sources))
    other = solve_scale(of(**{name: (7.3 * scale, by) for name, (scale, by) in sources.items()}))
    assert other.scale == pytest.approx(7.3 * one.scale, rel=1e-9)
    assert other.within == pytest.approx(one.within, rel=1e-3)
