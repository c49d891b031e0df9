"""A key that came later changes no digest of a suite that does not use it.

The values are those of a1d462b, before suites had `task`, `scores` and `plugins`; those of push,
stand, velocity and real came with these suites.
"""

import pytest

from nw_eval.suite import load_suite

SHIPPED = {
    "all": ("2c741d3ce0c0ff6b", "8d7001b6f417ed59"),
    "gaps-state": ("2c741d3ce0c0ff6b", "92d052ed80ab5694"),
    "gaps": ("2c741d3ce0c0ff6b", "0b42f2a262ef7b61"),
    "hurdles-state": ("38d711e686bdceec", "f59b3855903b1e9c"),
    "hurdles": ("38d711e686bdceec", "1eed02b771b15f2f"),
    "ramps-state": ("2c741d3ce0c0ff6b", "66fddc8df1f390b0"),
    "ramps": ("2c741d3ce0c0ff6b", "25f996d219956929"),
    "smoke": ("38d711e686bdceec", "b27b8ef10d2845c3"),
    "stairs-state": ("2c741d3ce0c0ff6b", "cacf532664e71cb5"),
    "stairs": ("2c741d3ce0c0ff6b", "de4bebba58e3d555"),
    "push": ("61204a8ea59dbe7f", "871e6020e5e9f4ff"),
    "stand": ("a49455c1ac6bd3bd", "f5c2b025797e71ae"),
    "real": ("2c741d3ce0c0ff6b", "0a1ed3d9341961f1"),
    "velocity": ("4ce2cba03b039640", "f74f37d474146b61"),
}


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_suite_keeps_the_digests_that_its_baselines_and_runs_have(name):
    suite = load_suite(name)
    assert (suite.digest[:16], suite.content_digest[:16]) == SHIPPED[name]
