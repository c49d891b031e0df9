from __future__ import annotations

import copy
from dataclasses import dataclass
from hashlib import sha256
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nw_base.errors import UsageError
from nw_eval.suite import Trial, expand, new_suite, override
from nw_gate.results.ended import wanted
from nw_gate.results.provenance import StopInfo
from nw_gate.results.request import Request

BASE: dict[str, Any] = {
    "nw-eval": 1,
    "name": "hurdles",
    "robot": "go1",
    "policy": "go1-parkour",
    "trials": 3,
    "seed": 20261,
    "scenes": ["hurdles/*"],
}


@dataclass(frozen=True)
class Place:
    name: str
    task: str = "hurdles"
    digest: str = "ab" * 32


ONE, TWO = Place("hurdles/one"), Place("hurdles/two", digest="cd" * 32)


def trial(**changes: Any) -> Trial:
    fields: dict[str, Any] = {
        "suite": "hurdles",
        "suite_digest": "00" * 32,
        "suite_seed": 20261,
        "scene": "hurdles/one_low_carpet",
        "scene_digest": "ab" * 32,
        "task": "hurdles",
        "index": 3,
    }
    return Trial(**{**fields, **changes})


def test_an_id_is_scene_and_index_and_fits_a_file_name() -> None:
    assert trial().id == "hurdles-one_low_carpet-003"
    assert trial(perturbation=(("friction", 0.6),)).id == "hurdles-one_low_carpet-003-friction_0.6"


def test_a_trial_says_how_much_its_scene_counts_and_keeps_its_identity() -> None:
    gate = {"success_rate": 0.5, "tiers": {"hurdles/one": "critical"}}
    told, plain = (expand(new_suite({**BASE, **more}), [ONE, TWO]) for more in ({"gate": gate}, {}))
    assert [t.tier for t in told[:2]] == ["critical", "supporting"]
    assert [t.identity for t in told] == [t.identity for t in plain]


def test_a_suite_expands_round_by_round_over_scenes_and_cells() -> None:
    suite = new_suite({**BASE, "trials": 2, "perturb": {"friction": [0.6, 1.0]}})
    assert [t.id for t in expand(suite, [ONE, TWO])] == [
        "hurdles-one-000-friction_0.6",
        "hurdles-two-000-friction_0.6",
        "hurdles-one-000-friction_1.0",
        "hurdles-two-000-friction_1.0",
        "hurdles-one-001-friction_0.6",
        "hurdles-two-001-friction_0.6",
        "hurdles-one-001-friction_1.0",
        "hurdles-two-001-friction_1.0",
    ]


def test_scenes_whose_trials_would_share_a_name_are_refused() -> None:
    with pytest.raises(UsageError, match="would both name a trial a-b-000"):
        expand(new_suite(BASE), [Place("a/b"), Place("a-b")])


def test_more_trials_and_other_policies_keep_the_earlier_trials() -> None:
    suite = new_suite(BASE)
    more = override(suite, Request(trials=5, policy="other", record="none"))
    earlier = {t.id: t.seed for t in expand(suite, [ONE, TWO])}
    later = {t.id: t.seed for t in expand(more, [TWO, ONE])}
    assert len(later) == 10
    assert {key: later[key] for key in earlier} == earlier


def test_the_seed_is_numpys_for_the_suite_seed_and_the_identity() -> None:
    # By hand: canonical JSON of the identity, hashed; then the hash of the empty stream name.
    text = f'["{"00" * 32}","{"ab" * 32}","hurdles",3,[]]'
    key = sha256(text.encode()).digest() + sha256(b"").digest()
    words = [int.from_bytes(key[at : at + 4], "little") for at in range(0, 64, 4)]
    expected = np.random.SeedSequence(entropy=20261, spawn_key=words).generate_state(1, np.uint64)
    assert trial().seed == int(expected[0])


@pytest.mark.parametrize(
    "change",
    [
        {"suite_seed": 1},
        {"suite_digest": "01" * 32},
        {"scene_digest": "ac" * 32},
        {"task": "stairs"},
        {"index": 4},
        {"perturbation": (("friction", 0.6),)},
    ],
)
def test_every_part_of_the_identity_moves_the_seed(change: dict[str, Any]) -> None:
    assert trial(**change).seed != trial().seed


def test_names_for_people_do_not_move_the_seed() -> None:
    assert trial(suite="renamed", scene="moved/away").seed == trial().seed


def test_no_two_trials_of_a_large_run_share_a_seed() -> None:
    suite = override(new_suite(BASE), Request(trials=2000))
    seeds = [t.seed for t in expand(suite, [ONE, TWO])]
    assert len(set(seeds)) == 4000


def test_streams_are_independent_of_who_asks_first() -> None:
    first = trial()
    spawn = first.generator("spawn").random(4)
    again = trial()
    again.generator("noise").random(100)
    assert (again.generator("spawn").random(4) == spawn).all()
    assert not (again.generator("noise").random(4) == spawn).any()


def test_a_trial_travels_to_another_process_unchanged() -> None:
    one = trial(perturbation=(("friction", 0.6),))
    assert one.seed  # Computed before the journey.
    arrived = copy.deepcopy(one)
    assert arrived == one
    assert arrived.seed == one.seed


@given(
    st.lists(st.floats(0.01, 5.0, allow_nan=False), min_size=1, max_size=5, unique=True),
    st.integers(1, 4),
)
def test_ids_are_unique_whatever_the_grid(values: list[float], trials: int) -> None:
    suite = new_suite({**BASE, "trials": trials, "perturb": {"friction": values}})
    expanded = expand(suite, [ONE, TWO])
    assert len({t.id for t in expanded}) == len(expanded) == 2 * trials * len(values)


def test_trials_of_a_drawn_order_are_those_of_their_index_at_their_place() -> None:
    suite = new_suite({**BASE, "perturb": {"friction": (0.5, 1.0)}})
    first, second = suite.perturb.cells
    order = [
        (ONE.name, second, 40),
        (TWO.name, first, 2),
        (ONE.name, second, 7),
        (ONE.name, first, 7),
    ]
    drawn = expand(suite, [ONE, TWO], order)
    assert [(t.scene, t.perturbation, t.index) for t in drawn] == order
    assert [t.place for t in drawn] == [0, 1, 2, 3]
    plain = {t.id: t for t in expand(override(suite, Request(trials=50)), [ONE, TWO])}
    for t in drawn:
        same = plain[t.id]
        assert (t.identity, t.seed) == (same.identity, same.seed)
        assert same.place is None
    enough = StopInfo(first=1, followed=(2,))
    assert wanted(drawn, enough) == (drawn[0], drawn[2])
    assert wanted(drawn, None) == drawn
