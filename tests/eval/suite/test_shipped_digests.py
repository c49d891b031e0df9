"""A key that came later changes no digest of a suite that does not use it.

The values are those of a1d462b, before suites had `task`, `scores` and `plugins`; those of push,
stand, velocity and real came with these suites, those of hurdles, gaps, ramps, stairs and all with
`render`.
"""

import pytest

from nw_eval.suite import load_suite

SHIPPED = {
    "all": ("bc48ebea3446283c", "6996aeefabd826a8"),
    "all-state": ("2c741d3ce0c0ff6b", "61409971f4b79f73"),
    "gaps-state": ("2c741d3ce0c0ff6b", "92d052ed80ab5694"),
    "gaps": ("bc48ebea3446283c", "b7e8398dc0b4c954"),
    "hurdles-state": ("38d711e686bdceec", "f59b3855903b1e9c"),
    "hurdles": ("dc8e9fa8ff5978f5", "106988c48efe4db0"),
    "ramps-state": ("2c741d3ce0c0ff6b", "66fddc8df1f390b0"),
    "ramps": ("bc48ebea3446283c", "b1fcb1f82c96d688"),
    "smoke": ("38d711e686bdceec", "b27b8ef10d2845c3"),
    "stairs-state": ("2c741d3ce0c0ff6b", "cacf532664e71cb5"),
    "stairs": ("bc48ebea3446283c", "e7d366f5bf2106d8"),
    "push": ("61204a8ea59dbe7f", "871e6020e5e9f4ff"),
    "stand": ("a49455c1ac6bd3bd", "f5c2b025797e71ae"),
    "real": ("2c741d3ce0c0ff6b", "869c74a6d608691c"),
    "velocity": ("4ce2cba03b039640", "f74f37d474146b61"),
}


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_suite_keeps_the_digests_that_its_baselines_and_runs_have(name):
    suite = load_suite(name)
    assert (suite.digest[:16], suite.content_digest[:16]) == SHIPPED[name]
