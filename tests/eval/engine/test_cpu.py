"""The kind of processor, by which libraries choose the kernels that decide bits."""

import os
import subprocess
import sys

import pytest

from nw_eval.engine.machine import cpu_kind

SCRIPT = """
from nw_eval.engine.machine import cpu_kind
from numba.core.registry import cpu_target

_, name, features = cpu_target.target_context.codegen().magic_tuple()
print(cpu_kind(), name, len(features), sep="|")
"""


def in_a_process(**settings):
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        env={**os.environ, **settings},
        capture_output=True,
        text=True,
        check=True,
    )
    kind, name, features = done.stdout.strip().split("|")
    return kind, name, int(features)


def test_the_name_is_the_one_that_numba_compiles_for():
    kind, name, _ = in_a_process()
    assert kind == cpu_kind()
    assert kind.split()[0] == name


def test_a_processor_that_was_asked_for_is_another_kind():
    kind, name, features = in_a_process(NUMBA_CPU_NAME="generic", NUMBA_CPU_FEATURES="")
    assert (name, features) == ("generic", 0)
    assert kind.split()[0] == "generic"
    assert kind.split()[1] != cpu_kind().split()[1]


SETTINGS = ("ATEN_CPU_CAPABILITY", "MKL_CBWR", "OPENBLAS_CORETYPE", "GLIBC_TUNABLES")


@pytest.mark.parametrize("setting", SETTINGS)
def test_what_makes_a_library_take_other_kernels_is_told(monkeypatch, setting):
    for name in SETTINGS:
        monkeypatch.delenv(name, raising=False)
    before = cpu_kind()
    monkeypatch.setenv(setting, "other\nline")
    assert cpu_kind() == f"{before} {setting}=other line"


def test_the_order_of_the_instruction_sets_is_nothing(monkeypatch):
    monkeypatch.setenv("NUMBA_CPU_FEATURES", "+avx2,+fma")
    one = cpu_kind()
    monkeypatch.setenv("NUMBA_CPU_FEATURES", "+fma, +avx2")
    assert cpu_kind() == one
    monkeypatch.setenv("NUMBA_CPU_FEATURES", "-fma,+avx2")
    assert cpu_kind() != one
