"""Trials in this very process: the rows of worker processes, and the caller's own objects."""

import os
import signal
import subprocess
import sys

import numpy as np
import pytest
from tests.trial_runs import run_trials

from nw_base.errors import PolicyError
from nw_base.trials import expand
from nw_eval import api
from nw_eval.engine import session
from nw_eval.engine.how import How
from nw_eval.engine.local import LocalProcesses
from nw_eval.engine.plan import Plan, plan_jobs
from nw_eval.engine.rounds import RunStanding
from nw_eval.engine.workers import InProcess
from nw_eval.suite.model import new_suite
from nw_gate.results.journal import Journal, JournalHeader, read_journal
from nw_gate.results.parquet import read_rows
from nw_gate.results.provenance import StopInfo, read_run_info
from nw_gate.results.request import Request
from nw_gate.results.row import rows_digest
from nw_gate.results.run_folder import RunFolder
from nw_policies import instance_bundle, load_bundle
from nw_policies.cards.card import Card
from nw_sim.catalogue import FoundScene
from nw_sim.rollout.mcap.reader import LogReader

SCENE = "flat/carpet_room"

CARD = {
    "nw-policy": 1,
    "name": "mine",
    "robot": "go1",
    "adapter": "python:mine:Policy",
    "control": {"action": "joint_position_offset", "scale": 0.25},
    "observations": {"proprio": {"sensor": "proprio", "layout": "parkour53"}},
}

SUITE = {
    "nw-eval": 1,
    "name": "tiny",
    "robot": "go1",
    "seed": 7,
    "episode": {"duration": 0.2},
    "scenes": [SCENE],
    "record": "none",
}

MODULE = """\
class Policy:
    def __init__(self, bundle):
        pass

    def act(self, observation):
        {deed}
"""


def standing(observation):
    """Answer as the shipped policy `stand` does."""
    assert observation["proprio"].shape == (53,)
    return np.zeros(12)


class Counting:
    """A policy with a memory, which it forgets at the start of a trial."""

    def __init__(self):
        self.steps = self.closed = 0
        self.seeds = []

    def reset(self, seed):
        self.steps = 0
        self.seeds.append(seed)

    def act(self, observation):
        self.steps += 1
        return np.full(12, 0.01 * self.steps + 0.0 * observation["proprio"][0])

    def state(self):
        return self.steps.to_bytes(8, "little")

    def restore(self, state):
        self.steps = int.from_bytes(state, "little")

    def close(self):
        self.closed += 1


class Ears:
    def __init__(self, then=None):
        self.messages, self.rows, self.then = [], [], then

    def message(self, text):
        self.messages.append(text)

    def scene(self, name, fraction):
        pass

    def planned(self, *, total, finished):
        pass

    def trial(self, row):
        self.rows.append(row)
        if self.then is not None:
            self.then()


def plan_of(bundle, *, trials, allow_code=False, drawn=None):
    """Return the plan of trials of a fifth of a second; `drawn` are their indexes in an order."""
    place = FoundScene.at(SCENE)
    suite = new_suite(SUITE | {"policy": bundle.name, "trials": trials})
    return Plan(
        request=Request(allow_code=allow_code),
        suite=suite,
        bundle=bundle,
        found=(place,),
        trials=expand(suite, [place.scene], drawn and [(SCENE, (), index) for index in drawn]),
    )


@pytest.fixture
def go(tmp_path):
    """Return what runs a bundle's trials of a fifth of a second, here or in worker processes."""

    def run(
        bundle, *, name="run", trials=2, apart=False, allow_code=False, ears=None, resume=False
    ):
        plan = plan_of(bundle, trials=trials, allow_code=allow_code)
        folder = RunFolder(path=tmp_path / name)
        jobs = plan_jobs(plan, folder)
        header = JournalHeader(suite_digest="s", policy_digest="p", scene_digests={})
        open_journal = Journal.resume if resume else Journal.create
        with open_journal(folder.journal, header) as journal:
            return run_trials(
                jobs,
                journal=journal,
                folder=folder,
                policy=bundle.name,
                start_workers=LocalProcesses(jobs, folder) if apart else InProcess(bundle),
                workers=1,
                listener=ears or Ears(),
            )

    return run


class BaselineComparison:
    """Asks nothing of the run but what is enough."""

    def __init__(self, enough):
        self.next = enough

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def begin(self, own, _interrupts):
        return own.info

    def end(self, _run):
        pass


@pytest.fixture
def session_of(tmp_path):
    """Return what runs a bundle's trials as `nw-eval run` does: in this process, or in workers."""

    def run(bundle, *, trials, enough=None, name="run", workers=None, resume=False, **how):
        return session.carry_out(
            plan_of(bundle, trials=trials, **how),
            How(workers=workers, in_process=workers is None),
            out=None if resume else tmp_path / name,
            resume=tmp_path / name if resume else None,
            comparison=None if enough is None else BaselineComparison(enough),
        )

    return run


def written(tmp_path, name, deed):
    """Return the bundle of a policy that is written into a folder, and does a deed at each step."""
    folder = tmp_path / name
    folder.mkdir(exist_ok=True)
    (folder / "policy.yaml").write_text(str(CARD | {"name": name}))
    (folder / "mine.py").write_text(MODULE.format(deed=deed))
    return load_bundle(folder)


def test_rows_and_logs_are_those_of_worker_processes(go, tmp_path):
    bundle = load_bundle("go1-parkour")
    here, there = go(bundle, name="here"), go(bundle, name="there", apart=True)
    assert rows_digest(here.rows) == rows_digest(there.rows)
    assert [row.state_digest for row in here.rows] == [row.state_digest for row in there.rows]
    assert len({row.action_digest for row in here.rows}) == 2
    for row in here.rows:
        log = LogReader(tmp_path / "here" / row.mcap_path)
        other = LogReader(tmp_path / "there" / row.mcap_path)
        assert log.metadata()["nw.verdict"] == other.metadata()["nw.verdict"]


def test_what_a_policy_raises_is_its_result_here_too(go, tmp_path):
    ears = Ears()
    outcome = go(written(tmp_path, "raiser", "1 / 0"), trials=1, allow_code=True, ears=ears)
    [row] = outcome.rows
    assert (row.outcome, row.end_reason, row.attempt) == ("policy_failed", "exception", 2)
    assert "ZeroDivisionError" in row.error_text
    assert ears.messages[0].endswith("it will run again in this process")


def test_a_policy_file_that_was_edited_is_run_as_it_is_now(go, tmp_path, monkeypatch):
    # Python itself takes what it has compiled for a file of the same size and second.
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    still = go(written(tmp_path, "still", "return [0.0] * 12"), name="one", allow_code=True)
    moved = go(written(tmp_path, "still", "return [0.1] * 12"), name="two", allow_code=True)
    assert still.rows[0].action_digest != moved.rows[0].action_digest
    other = go(written(tmp_path, "other", "return [0.0] * 12"), name="three", allow_code=True)
    assert other.rows[0].action_digest == still.rows[0].action_digest


def test_ctrl_c_lets_the_trial_end_and_the_rest_can_be_resumed(go, tmp_path):
    bundle = load_bundle("stand")
    ears = Ears(then=lambda: os.kill(os.getpid(), signal.SIGINT))
    cut = go(bundle, trials=3, ears=ears)
    assert (cut.interrupted, len(cut.rows), len(cut.missing)) == (signal.SIGINT, 1, 2)
    assert len(read_journal(tmp_path / "run" / "journal.jsonl").rows) == 1
    whole = go(bundle, trials=3, name="whole")
    assert rows_digest(go(bundle, trials=3, resume=True).rows) == rows_digest(whole.rows)


def test_a_function_is_a_policy_and_its_rows_are_those_of_its_card(go, tmp_path):
    mine = go(instance_bundle(standing, Card.model_validate(CARD)), name="mine")
    file = written(tmp_path, "mine-as-file", "return [0.0] * 12")
    assert [row.status for row in mine.rows] == ["ok", "ok"]
    assert [row.state_digest for row in mine.rows] == [
        row.state_digest for row in go(file, name="file", allow_code=True).rows
    ]
    log = LogReader(tmp_path / "mine" / mine.rows[0].mcap_path)
    assert Card.model_validate_json(log.attachments()["policy.yaml"]) == Card.model_validate(CARD)


def test_an_object_is_reset_for_every_trial_and_never_closed(go):
    policy = Counting()
    bundle = instance_bundle(policy, Card.model_validate(CARD), digest="ab" * 32)
    first = go(bundle, name="first")
    assert {row.checkpoint_digest for row in first.rows} == {"ab" * 32}
    assert len(set(policy.seeds)) == 2
    assert policy.closed == 0
    assert rows_digest(go(bundle, name="again").rows) == rows_digest(first.rows)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"adapter": "zero"}, "opens files, the policy is an object"),
        ({"checkpoint": {"file": "weights.pt"}}, "names `checkpoint`, the policy is an object"),
    ],
)
def test_a_card_of_files_is_refused_for_an_object(change, said):
    with pytest.raises(PolicyError, match=said):
        instance_bundle(standing, Card.model_validate(CARD | change))


def test_an_object_that_cannot_act_costs_its_trials_and_says_why(go):
    [row] = go(instance_bundle(3, Card.model_validate(CARD)), trials=1).rows
    assert row.outcome == "policy_failed"
    assert "card 'mine': python:mine:Policy has no method `act`" in row.error_text


def test_a_breakpoint_in_a_policy_opens_the_debugger(tmp_path):
    written(tmp_path, "stopper", "breakpoint(); return [0.0] * 12")
    suite = SUITE | {"policy": "./stopper", "trials": 1}
    (tmp_path / "suite.yaml").write_text(str(suite))
    main = [sys.executable, "-c", "from nw_eval.cli import main; main()"]
    typed = [
        "p observation['proprio'].shape",
        "import os",
        "os.environ['PYTHONBREAKPOINT'] = '0'",
        "c",
    ]
    ran = subprocess.run(
        [*main, "run", "suite.yaml", "--allow-code", "--in-process", "--out", "run"],
        input="\n".join(typed),
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    assert f"> {tmp_path.resolve() / 'stopper' / 'mine.py'}(6)act()" in ran.stdout
    assert "(Pdb) (53,)" in ran.stdout
    assert [row.status for row in read_journal(tmp_path / "run" / "journal.jsonl").rows] == ["ok"]


def test_torch_has_its_threads_back_after_a_run(go):
    import torch

    before = torch.get_num_threads()
    seen = []

    def looking(observation):
        seen.append(torch.get_num_threads())
        return standing(observation)

    try:
        torch.set_num_threads(3)
        go(instance_bundle(looking, Card.model_validate(CARD)), trials=1)
        assert torch.get_num_threads() == 3
    finally:
        torch.set_num_threads(before)
    assert set(seen) == {1}


def test_run_json_and_report_say_that_nothing_stood_between(session_of):
    folder = session_of(instance_bundle(standing, Card.model_validate(CARD)), trials=1)
    info = read_run_info(folder.run_json)
    assert info.fence == "off: in the calling process"
    assert (info.workers, info.stop) == (1, None)
    assert (info.policy.card, info.policy.origin) == ("", "an object in the calling process")
    ran = api.report(folder.path)
    assert (ran.verdict.verdict, len(ran.rows)) == ("RAN", 1)
    assert "mine, an object in the calling process" in folder.report_md.read_text()


def enough_after(first, *, followed=(), ended=0):
    """Return what finds the first trials of an order of five enough, once so many have ended."""

    def enough(rows):
        lacking = [place for place in (*range(first), *followed) if place not in rows]
        if not lacking and len(rows) >= ended:
            return RunStanding(first=first, followed=followed)
        nexts = lacking if followed else range(5)
        return RunStanding(first=0, pending=tuple(place for place in nexts if place not in rows))

    return enough


def judged(folder):
    rows, _ = read_rows(folder.trials)
    return rows


def test_run_json_says_which_trials_were_enough(session_of):
    order = [4, 0, 3, 1, 2]
    folder = session_of(
        load_bundle("stand"), trials=5, drawn=order, enough=enough_after(2, followed=(3,))
    )
    stop = StopInfo(first=2, followed=(3,), trials={SCENE: 3})
    assert read_run_info(folder.run_json).stop == stop
    assert read_run_info(folder.run_json).planned == {SCENE: 3}
    assert [row.seed_index for row in read_journal(folder.journal).rows] == [4, 0, 1]
    assert {row.seed_index for row in judged(folder)} == {4, 0, 1}


def test_trials_that_ended_beyond_what_was_enough_are_no_rows_of_the_run(session_of):
    order = [4, 0, 3, 1, 2]
    bundle = load_bundle("stand")
    less = session_of(bundle, trials=5, drawn=order, enough=enough_after(2), name="less")
    more = session_of(bundle, trials=5, drawn=order, enough=enough_after(2, ended=4), name="more")
    infos = [read_run_info(folder.run_json) for folder in (less, more)]
    assert [info.stop for info in infos] == [StopInfo(first=2, trials={SCENE: 2})] * 2
    assert len(read_journal(more.journal).rows) == 4
    assert {row.seed_index for row in judged(more)} == {4, 0}
    assert len({info.rows_digest for info in infos}) == 1
    all_of_them = session_of(bundle, trials=5, drawn=order, name="more", resume=True)
    assert read_run_info(all_of_them.run_json).stop is None
    assert len(judged(all_of_them)) == 5, "what had ended was kept"


OVERTAKEN = """\
from pathlib import Path
from time import sleep

class Policy:
    def __init__(self, bundle):
        self.flag = Path(__file__).with_name("overtaken")

    def reset(self, seed):
        while seed == {first} and not self.flag.exists():
            sleep(0.01)

    def act(self, observation):
        return [0.0] * 12
"""


def test_workers_that_overtake_each_other_judge_the_trials_that_one_alone_does(
    session_of, tmp_path
):
    order = [4, 0, 3, 1, 2]
    bundle = written(tmp_path, "overtaken", "pass")
    planned = plan_of(bundle, trials=5, drawn=order).trials

    def run(first, **how):
        """Run with a policy whose first trial ends after a later one has ended."""
        (bundle.folder / "mine.py").write_text(OVERTAKEN.format(first=first))
        asked = []

        def enough(rows):
            asked.append(set(rows))
            if rows and 0 not in rows:
                (bundle.folder / "overtaken").touch()
            return enough_after(1)(rows)

        mine = load_bundle(bundle.folder)
        folder = session_of(mine, trials=5, drawn=order, enough=enough, allow_code=True, **how)
        return folder, asked

    alone, _ = run(-1, name="alone")
    (bundle.folder / "overtaken").unlink(missing_ok=True)
    waits = int(planned[0].seed_sequence("policy").generate_state(1, np.uint32)[0])
    together, asked = run(waits, name="together", workers=3)
    assert any(rows and 0 not in rows for rows in asked), "a later trial ended first"
    infos = [read_run_info(folder.run_json) for folder in (alone, together)]
    assert [info.stop for info in infos] == [StopInfo(first=1, trials={SCENE: 1})] * 2
    [row], [other] = judged(alone), judged(together)
    assert (row.trial_id, row.state_digest) == (other.trial_id, other.state_digest)
    beyond = [row.trial_id for row in read_journal(together.journal).rows]
    assert beyond[-1] == row.trial_id
    assert len(beyond) > 1
    assert [*together.logs.rglob("*.partial")] == []
