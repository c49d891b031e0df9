"""The filter of system calls, run step by step, for this machine and for others."""

import errno

import pytest

from nw_eval.confinement.seccomp import MACHINES, program

ALLOW, FAIL, KILL = 0x7FFF0000, 0x00050000, 0x80000000
REFUSED = FAIL | errno.EPERM
THREAD = 0x3D0F00  # The flags with which the C library starts a thread.
FORK = 0x1200011  # Those of fork: SIGCHLD, and where to write the number of the child.
CALLS = {
    "x86_64": {"read": 0, "openat": 257, "execve": 59, "clone": 56, "clone3": 435, "kill": 62}
    | {"socket": 41, "connect": 42, "ptrace": 101, "futex": 202, "prlimit64": 302},
    "aarch64": {"read": 63, "openat": 56, "execve": 221, "clone": 220, "clone3": 435, "kill": 129}
    | {"socket": 198, "connect": 203, "ptrace": 117, "futex": 98, "prlimit64": 261},
}
ME = 4711


def answer(steps, number, *, first=0, machine):
    """Run a filter as the kernel does, and return what it returns."""
    data, place, value = {0: number, 4: machine, 16: first}, 0, 0
    while True:
        step = steps[place]
        if step.code == 0x06:
            return step.value
        if step.code == 0x20:
            value = data[step.value]
            place += 1
            continue
        holds = {0x15: value == step.value, 0x35: value >= step.value, 0x45: value & step.value}
        place += 1 + (step.if_true if holds[step.code] else step.if_false)


@pytest.fixture(params=["x86_64", "aarch64"])
def ask(request):
    machine = request.param

    def ask(call, first=0, *, network="none"):
        steps = program(machine, process=ME, network=network)
        number = CALLS[machine].get(call, call)
        return answer(steps, number, first=first, machine=MACHINES[machine])

    return ask


def test_what_every_library_does_is_allowed(ask):
    assert {ask("read"), ask("openat"), ask("futex"), ask("clone", THREAD)} == {ALLOW}


def test_programs_processes_and_sockets_are_refused(ask):
    assert {ask(call) for call in ("execve", "ptrace", "socket", "connect")} == {REFUSED}
    assert ask("clone", FORK) == REFUSED
    assert ask("clone3") == FAIL | errno.ENOSYS


def test_only_the_process_itself_gets_signals_and_limits(ask):
    assert (ask("kill", ME), ask("prlimit64", 0), ask("prlimit64", ME)) == (ALLOW,) * 3
    assert (ask("kill", ME + 1), ask("kill", 2**32 - 1), ask("prlimit64", 1)) == (REFUSED,) * 3


def test_a_server_listens_and_does_not_connect(ask):
    assert (ask("socket", network="server"), ask("connect", network="server")) == (ALLOW, REFUSED)
    assert (ask("socket", network="all"), ask("connect", network="all")) == (ALLOW, ALLOW)


def test_numbers_of_another_machine_end_the_process():
    for own, other in (("x86_64", "aarch64"), ("aarch64", "x86_64")):
        steps = program(own, process=ME, network="none")
        assert answer(steps, 0, machine=MACHINES[other]) == KILL
    steps = program("x86_64", process=ME, network="none")
    assert answer(steps, 0x40000000 | 59, machine=MACHINES["x86_64"]) == REFUSED
