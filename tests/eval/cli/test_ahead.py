"""What is begun before arguments are parsed, and what is not."""

import subprocess
import sys

import pytest

from nw_eval.cli.verbs import begin
from nw_sim.rollout.confined import start


@pytest.mark.parametrize(
    ("arguments", "begins"),
    [
        (["run", "hurdles"], True),
        (["run", "hurdles", "--policy", "stand", "--no-cache"], True),
        (["run", "--help"], False),
        (["run", "hurdles", "-h"], False),
        (["run", "hurdles", "--in-process"], False),
        (["run", "hurdles", "--in_process"], False),
        (["run", "hurdles", "--engine=ray"], False),
        (["run", "hurdles", "--allow-code"], False),
        (["run", "hurdles", "--render", "cuda"], False),
        (["report", "run"], False),
        (["run"], False),
        ([], False),
    ],
)
def test_a_run_in_forked_processes_starts_what_they_are_forked_from(arguments, begins, monkeypatch):
    begun = []
    monkeypatch.setattr(start, "prepare", lambda: begun.append(""))
    begin(arguments)
    assert begun == [""] * begins


def test_that_is_the_one_that_the_run_goes_on_with():
    code = (
        "from nw_eval.cli.verbs import begin; begin(['run', 'hurdles']); "
        "from nw_sim.rollout.confined import start; first = start._fork_server; "
        "from nw_eval.cli.verbs import parse; import nw_eval.api.runs; start.prepare(); "
        "assert first is not None and first is start._fork_server; first.__del__()"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)


def test_nobody_waits_for_the_simulator_before_the_first_trial_starts():
    modules = ("nw_eval.api.runs", "nw_eval.api.plans", "nw_eval.engine.session")
    modules += ("nw_sim.rollout.confined.vetting", "nw_eval.engine.known")
    code = f"import sys, {', '.join(modules)}; print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120
    )
    assert not {"mujoco", "torch", "numba", "pandas", "PIL", "jinja2"} & set(done.stdout.split())
