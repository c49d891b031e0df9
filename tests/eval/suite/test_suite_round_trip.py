from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from nw_eval.suite import load_suite, new_suite, suite_yaml

if TYPE_CHECKING:
    from pathlib import Path

names = st.from_regex(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,20}", fullmatch=True)
# Whatever YAML could mistake for something else: numbers, booleans, dates, colons, quotes.
words = st.one_of(
    st.text(st.characters(exclude_categories=("Cs", "Cc", "Cn", "Co")), min_size=1, max_size=30),
    st.sampled_from(["yes", "null", "1", "1e3", "2026-01-01", "*", "a: b", "#", "'", '"', "~"]),
)
keys = words.filter(str.isprintable)
shares = st.floats(0.0, 1.0, exclude_min=True, exclude_max=True)
frictions = st.floats(0.0, 5.0, exclude_min=True)


@st.composite
def suites(draw: st.DrawFn) -> dict[str, Any]:
    tolerate, max_drop = sorted([draw(shares), draw(shares)])
    return {
        "nw-eval": 1,
        "name": draw(names),
        "robot": "go1",
        "policy": draw(words),
        "protocol": draw(st.sampled_from(["strict", "neverwhere-2026"])),
        "trials": draw(st.integers(1, 100_000)),
        "seed": draw(st.integers(0, 2**63 - 1)),
        "episode": {"duration": draw(st.floats(0.0, 600.0, exclude_min=True))},
        "scenes": draw(st.lists(words, min_size=1, max_size=5, unique=True)),
        "perturb": {"friction": draw(st.lists(frictions, max_size=4, unique=True))},
        "record": draw(st.sampled_from(["all", "failures", "none", "summary"])),
        "gate": {
            "success_rate": draw(st.none() | st.floats(1e-6, 1.0 - 1e-6)),
            "baseline": draw(st.none() | words),
            "max_drop": max_drop,
            "tolerate": tolerate,
            "scene_drop": draw(shares),
            "rounds": draw(st.integers(1, 10_000)),
            "false_alarm": draw(st.floats(0.001, 0.5)),
            "confidence": draw(st.floats(0.5, 0.9999)),
            "tiers": draw(
                st.dictionaries(
                    keys, st.sampled_from(["critical", "supporting", "informational"]), max_size=3
                )
            ),
        },
    }


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(suites())
def test_a_suite_written_as_yaml_reads_back_equal(tmp_path: Path, said: dict[str, Any]) -> None:
    suite = new_suite(said)
    path = tmp_path / "suite.yaml"
    path.write_text(suite_yaml(suite), encoding="utf-8")
    again = load_suite(path)
    assert again == suite
    assert again.digest == suite.digest
    assert again.content_digest == suite.content_digest


def test_a_key_that_no_file_may_have_is_refused_in_python_too() -> None:
    tiers = {"stairs/\U000e0001": "critical"}
    with pytest.raises(ValidationError, match=r"is not a key; use a short printable name"):
        new_suite(
            {"nw-eval": 1, "name": "a", "policy": "p", "scenes": ["s"], "gate": {"tiers": tiers}}
        )
