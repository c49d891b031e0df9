"""How many cores a process may use: by affinity, and by the quota of its control groups."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import nw_eval
from nw_gate.results.provenance import machine_info, usable_cores

V1, V1_JOINT = "4:memory:/job\n3:cpu:/job/step\n", "3:cpu,cpuacct:/job/step\n"


@pytest.fixture
def four(monkeypatch):
    """A machine of four cores, all of which this process may run on."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1, 2, 3})


def system(tmp_path, groups, files):
    for name, text in {"proc/self/cgroup": groups, **files}.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tmp_path


@pytest.mark.usefixtures("four")
@pytest.mark.parametrize(
    ("groups", "files", "cores"),
    [
        ("0::/\n", {"sys/fs/cgroup/cpu.max": "200000 100000\n"}, 2),
        ("0::/\n", {"sys/fs/cgroup/cpu.max": "150000 100000\n"}, 2),
        ("0::/\n", {"sys/fs/cgroup/cpu.max": "20000 100000\n"}, 1),
        ("0::/\n", {"sys/fs/cgroup/cpu.max": "max 100000\n"}, 4),
        ("0::/\n", {"sys/fs/cgroup/cpu.max": "6400000 100000\n"}, 4),
        ("0::/\n", {"sys/fs/cgroup/cpu.max": "nonsense\n"}, 4),
        # The least of a group and those that it is in.
        (
            "0::/job/step\n",
            {
                "sys/fs/cgroup/job/step/cpu.max": "max 100000\n",
                "sys/fs/cgroup/job/cpu.max": "300000 100000\n",
            },
            3,
        ),
        # A container that is told its name outside, and sees its own group as the root.
        ("0::/docker/0123\n", {"sys/fs/cgroup/cpu.max": "100000 100000\n"}, 1),
        *(
            (groups, {f"sys/fs/cgroup/{folder}/cpu.cfs_{w}_us": t for w, t in texts.items()}, n)
            for groups, folder, texts, n in [
                (V1, "cpu/job/step", {"quota": "200000\n", "period": "100000\n"}, 2),
                (V1, "cpu/job", {"quota": "100000\n", "period": "100000\n"}, 1),
                (V1, "cpu/job", {"quota": "-1\n", "period": "100000\n"}, 4),
                (V1, "memory/job", {"quota": "100000\n", "period": "100000\n"}, 4),
                (V1_JOINT, "cpu,cpuacct/job", {"quota": "300000\n", "period": "100000\n"}, 3),
                (V1_JOINT, "cpu", {"quota": "100000\n", "period": "100000\n"}, 1),
            ]
        ),
    ],
)
def test_a_quota_of_control_groups_counts(tmp_path, groups, files, cores):
    assert usable_cores(system(tmp_path, groups, files)) == cores


@pytest.mark.usefixtures("four")
def test_where_there_are_no_control_groups_the_affinity_counts(tmp_path):
    assert usable_cores(tmp_path) == 4


def test_a_process_that_may_run_on_one_core_counts_one():
    code = (
        "import os; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))}); "
        "from nw_gate.results.provenance import machine_info, usable_cores; "
        "from nw_eval.engine.machine import worker_count; "
        "print(usable_cores(), machine_info().cores, worker_count(None, 9))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["1", "1", "1"]


def test_a_share_of_the_cores_is_a_share_of_those_that_may_be_used(pytester):
    pytester.makepyfile(
        """
        import os
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
        from nw_eval.pytest_plugin.runs import runs_of

        def test_share(pytestconfig):
            runs = runs_of(pytestconfig)
            assert runs._sharing == 1
            assert runs._workers == 1
        """
    )
    done = pytester.runpytest_subprocess("-n", "1")
    done.assert_outcomes(passed=1)


def test_cores_are_counted_in_one_place():
    harness = Path(nw_eval.__file__).parents[1]
    counting = re.compile(r"\b(cpu_count|sched_getaffinity|process_cpu_count)\(")
    found = {
        path.relative_to(harness).as_posix()
        for path in harness.rglob("*.py")
        if counting.search(path.read_text())
    }
    # The fence bounds the threads that libraries start for each installed processor.
    assert found == {"nw_base/confinement/rights.py", "nw_gate/results/provenance.py"}
    assert machine_info().cores == usable_cores()
