"""The filter of system calls, run step by step, for this machine and for others."""

import errno

import pytest

from nw_base.confinement.seccomp import ALLOWED, MACHINES, SERVING, WRITING, named, program

ALLOW, FAIL, KILL = 0x7FFF0000, 0x00050000, 0x80000000
REFUSED, UNKNOWN = FAIL | errno.EPERM, FAIL | errno.ENOSYS
THREAD = 0x3D0F00  # The flags with which the C library starts a thread.
FORK = 0x1200011  # Those of fork: SIGCHLD, and where to write the number of the child.
CALLS = {
    "x86_64": {"read": 0, "openat": 257, "execve": 59, "clone": 56, "clone3": 435, "kill": 62}
    | {"socket": 41, "connect": 42, "ptrace": 101, "futex": 202, "prlimit64": 302, "mmap": 9}
    | {"ioctl": 16, "fcntl": 72, "prctl": 157, "mkdirat": 258, "msgrcv": 70, "socketpair": 53}
    | {"sched_setaffinity": 203, "io_uring_setup": 425, "tgkill": 234},
    "aarch64": {"read": 63, "openat": 56, "execve": 221, "clone": 220, "clone3": 435, "kill": 129}
    | {"socket": 198, "connect": 203, "ptrace": 117, "futex": 98, "prlimit64": 261, "mmap": 222}
    | {"ioctl": 29, "fcntl": 25, "prctl": 167, "mkdirat": 34, "msgrcv": 188, "socketpair": 199}
    | {"sched_setaffinity": 122, "io_uring_setup": 425, "tgkill": 131},
}
ME = 4711


def answer(steps, number, *, arguments=(), machine):
    """Run a filter as the kernel does, and return what it returns."""
    data = {0: number, 4: machine} | {16 + 8 * at: value for at, value in enumerate(arguments)}
    place, value = 0, 0
    while True:
        step = steps[place]
        place += 1
        if step.code == 0x06:
            return step.value
        if step.code == 0x20:
            value = data[step.value]
        elif step.code == 0x05:
            place += step.value
        else:
            holds = {0x15: value == step.value, 0x35: value >= step.value, 0x45: value & step.value}
            place += step.if_true if holds[step.code] else step.if_false


@pytest.fixture(params=["x86_64", "aarch64"])
def ask(request):
    machine = request.param

    def ask(call, *arguments, network="none", **how):
        steps = program(machine, process=ME, network=network, **how)
        number = CALLS[machine].get(call, call)
        given = (*arguments, 0, 0, 0, 0, 0, 0)[:6]
        return answer(steps, number, arguments=given, machine=MACHINES[machine])

    return ask


def test_what_every_library_does_is_allowed(ask):
    assert {ask("read"), ask("openat"), ask("futex"), ask("clone", THREAD)} == {ALLOW}


def test_programs_processes_and_sockets_are_refused(ask):
    assert {ask(call) for call in ("execve", "ptrace", "socket", "connect")} == {REFUSED}
    assert {ask("clone", flags) for flags in (FORK, 0, THREAD | 0x10000000)} == {REFUSED}
    assert (ask("clone3"), ask("io_uring_setup"), ask(10**4)) == (UNKNOWN,) * 3


def test_only_the_process_itself_gets_signals_and_limits(ask):
    assert (ask("kill", ME), ask("prlimit64", 0), ask("prlimit64", ME)) == (ALLOW,) * 3
    others = ("kill", ME + 1), ("kill", 0), ("kill", 2**32 - 1), ("tgkill", 1), ("prlimit64", 1)
    assert {ask(*other) for other in others} == {REFUSED}
    assert ask("sched_setaffinity", ME + 1) == FAIL, "it says that it was done"


def test_a_server_listens_and_does_not_connect(ask):
    assert (ask("socket", 2, network="server"), ask("connect", network="server")) == (
        ALLOW,
        REFUSED,
    )
    assert (ask("socket", 10, network="all"), ask("connect", network="all")) == (ALLOW, ALLOW)
    assert {ask("socket", family, network="all") for family in (1, 16, 17, 38, 40)} == {REFUSED}


@pytest.mark.parametrize(
    ("call", "allowed", "refused"),
    [
        ("ioctl", [(3, 0x5401), (3, 0x541B)], [(3, 0xC0045877), (3, 0x8004587D), (3, 0x5412)]),
        ("fcntl", [(3, 1), (3, 1030)], [(3, 8), (3, 10), (3, 1026), (3, 6)]),
        ("prctl", [(15,)], [(1,), (4,), (22,), (47,)]),
        ("socketpair", [(1, 1), (1, 0x80001)], [(1, 2), (1, 5), (2, 1)]),
        ("mmap", [(0, 1, 3, 0x22), (0, 1, 3, 1)], [(0, 1, 3, 0x21), (0, 1, 3, 0x122)]),
    ],
)
def test_some_calls_are_allowed_by_their_arguments(ask, call, allowed, refused):
    assert {ask(call, *arguments) for arguments in allowed} == {ALLOW}
    assert {ask(call, *arguments) for arguments in refused} == {REFUSED}


def test_who_writes_no_file_makes_none_and_opens_none_for_writing_without_landlock(ask):
    assert (ask("mkdirat"), ask("mkdirat", writes=True)) == (REFUSED, ALLOW)
    for flags in (1, 2, 0o100, 0o1000):
        assert ask("openat", 0, 0, flags) == ALLOW
        assert ask("openat", 0, 0, flags, opens_to_write=False) == REFUSED
    assert ask("openat", 0, 0, 0o2000000, opens_to_write=False) == ALLOW


@pytest.mark.parametrize("machine", MACHINES)
def test_every_number_that_is_on_no_list_is_refused(machine):
    column = list(MACHINES).index(machine)
    known = [
        numbers for text in (*ALLOWED.values(), WRITING, SERVING) for _, numbers in named(text)
    ]
    steps = program(machine, process=ME, network="server", writes=True)
    listed = {numbers[column] for numbers in known if column < len(numbers)}
    assert len(listed) == len([numbers for numbers in known if column < len(numbers)])
    for number in {*range(600), 0x40000000, 2**32 - 1}:
        came = answer(steps, number, arguments=(0,) * 6, machine=MACHINES[machine])
        assert number in listed or came == (UNKNOWN if number >= 424 else REFUSED), number


def test_numbers_of_another_machine_end_the_process():
    for own, other in (("x86_64", "aarch64"), ("aarch64", "x86_64")):
        steps = program(own, process=ME, network="none")
        assert answer(steps, 0, machine=MACHINES[other]) == KILL
