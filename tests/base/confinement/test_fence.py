"""What a confined process can do, and what it cannot, tried in real ones."""

import subprocess
import sys
import time
from multiprocessing import active_children
from pathlib import Path

import pytest

from nw_base.confinement import Fence, Rules, offered
from nw_base.errors import PolicyError
from nw_sim.rollout.confined.isolated import call_isolated

fenced = pytest.mark.skipif(
    not (offered().landlock >= 3 and offered().seccomp), reason="this kernel has no whole fence"
)

REFUSED = "PermissionError"


@pytest.fixture
def places(tmp_path):
    """Return three folders: one that is read, one that is neither, one that is written."""
    made = {name: tmp_path / name for name in ("inside", "outside", "logs")}
    for folder in made.values():
        folder.mkdir()
        (folder / "file").write_text("secret" if folder.name == "outside" else "open")
    (made["inside"] / "link").symlink_to(made["outside"] / "file")
    (made["logs"] / "taken.mcap").symlink_to("../outside/file")  # As `results.log_links` has them.
    return made


def attempted(functions, places, **rules):
    rules = Rules(reads=(places["inside"],), writes=(places["logs"],), **rules)
    paths = {name: str(path) for name, path in places.items()}
    return call_isolated(functions.attempts, subject="x", rules=rules, **paths)


@fenced
def test_a_confined_process_reads_and_writes_its_own_places_and_no_other(functions, places):
    came = attempted(functions, places)
    allowed = ("read inside", "write a log", "move a log", "signal itself", "start a thread")
    assert {name: came.pop(name) for name in allowed} == {
        "read inside": "'open'",
        "write a log": "4",
        "move a log": repr(places["logs"] / "moved")[:100],
        "signal itself": "None",
        "start a thread": "None",
    }
    assert came.pop("change them by name") == "OSError"  # ENOSYS: as on a kernel that has no such.
    assert came == dict.fromkeys(came, REFUSED)
    assert (places["outside"] / "file").read_text() == "secret"
    assert [path.name for path in places["outside"].iterdir()] == ["file"]
    assert (places["inside"] / "file").read_text() == "open"


@fenced
@pytest.mark.skipif(
    not any(Path("/sys/bus/pci/devices").glob("*/vendor")), reason="no PCI bus to look at"
)
def test_a_confined_process_is_told_which_devices_there_are_and_reads_no_more_of_them(functions):
    count, came = call_isolated(functions.looks_for_accelerators, subject="x", rules=Rules())
    assert count == len(list(Path("/sys/bus/pci/devices").iterdir()))
    assert came == REFUSED


@fenced
def test_a_policy_that_asks_a_server_gets_sockets_and_nothing_else(functions, places):
    came = attempted(functions, places, network="all")
    assert came["socket"].startswith("<socket.socket")
    refused = ("read outside", "run", "fork", "kill the parent", "write outside")
    refused += ("write by a link to a log",)
    assert {came[name] for name in refused} == {REFUSED}


def test_code_that_the_caller_trusts_may_do_what_he_may(functions, places):
    came = attempted(functions, places, off="--allow-code")
    assert (came["read outside"], came["write outside"]) == ("'secret'", "4")


def test_a_process_gets_as_much_memory_as_its_rules_say(functions):
    with pytest.raises(
        PolicyError, match=r"^x: .* takes more memory than 1\.0 GiB; export the actor"
    ):
        call_isolated(functions.fills_memory, subject="x")
    assert call_isolated(functions.fills_memory, subject="x", rules=Rules(memory=2**33)) == 2**31


def test_a_process_gets_as_much_processor_time_as_its_rules_say(functions, tmp_path):
    before = {child.pid for child in active_children()}
    rules = Rules(writes=(tmp_path,), seconds=2)
    with pytest.raises(PolicyError, match=r"card: .* takes too long: more processor time"):
        call_isolated(functions.spins, subject="card", rules=rules, mark=str(tmp_path / "mark"))
    assert {child.pid for child in active_children()} == before


def test_what_a_confined_process_prints_reaches_nobody(functions, capfd):
    call_isolated(functions.prints, subject="x")
    assert capfd.readouterr() == ("", "")


def is_gone(process, seconds=0.0):
    """Whether a process has ended, or does so soon."""
    deadline = time.monotonic() + seconds
    while True:
        try:
            state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
        except (FileNotFoundError, ProcessLookupError):
            return True
        if state == "Z":
            return True
        if time.monotonic() > deadline:
            return False
        time.sleep(0.02)


CALL = """\
import sys
sys.path.insert(0, sys.argv[1])
import confined_functions
from pathlib import Path
from nw_base.confinement import Rules
from nw_sim.rollout.confined.isolated import call_isolated

if __name__ == "__main__":
    function = getattr(confined_functions, sys.argv[2])
    mark = Path(sys.argv[3])
    rules = Rules(writes=(mark.parent,), off=sys.argv[4])
    call_isolated(function, subject="x", rules=rules, mark=str(mark))
"""


@pytest.mark.parametrize(("function", "off"), [("spins", ""), ("leaves_children", "--allow-code")])
def test_nothing_outlives_a_caller_that_is_killed(functions, tmp_path, function, off):
    script, mark = tmp_path / "call.py", tmp_path / "mark"
    script.write_text(CALL)
    code = str(Path(functions.__file__).parent)
    caller = subprocess.Popen([sys.executable, str(script), code, function, str(mark), off])
    child = wait_for_number(mark)
    assert not is_gone(child)
    caller.kill()
    caller.wait()
    assert is_gone(child, seconds=60.0)


@pytest.mark.nightly
def test_a_time_limit_ends_what_trusted_code_has_started_too(functions, tmp_path):
    mark = tmp_path / "mark"
    with pytest.raises(PolicyError, match="no answer"):
        call_isolated(
            functions.leaves_children,
            subject="x",
            rules=Rules(off="--allow-code"),
            time_limit=8.0,
            mark=str(mark),
        )
    assert is_gone(int(mark.read_text()), seconds=60.0)


def wait_for_number(path):
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline:
        if path.exists() and path.read_text():
            return int(path.read_text())
        time.sleep(0.02)
    raise AssertionError("the child did not get going")


WITHOUT = """\
import os, sys
from nw_base.confinement import Rules, confine
from nw_base.confinement.seccomp import Instruction, install

# The kernel's answers where it is older, or a container forbids: of Landlock's calls, of a filter.
landlock, seccomp = 0x00050026, 0x00050016  # ENOSYS, EINVAL
load, equal, leave = 0x20, 0x15, 0x06
steps = [Instruction(load, 0)]
if "landlock" in sys.argv:
    for number in (444, 445, 446):
        steps += [Instruction(equal, number, if_false=1), Instruction(leave, landlock)]
if "seccomp" in sys.argv:
    prctl = {"x86_64": 157, "aarch64": 167}[os.uname().machine]
    steps += [
        Instruction(equal, prctl, if_false=3),
        Instruction(load, 16),
        Instruction(equal, 22, if_false=1),
        Instruction(leave, seccomp),
    ]
install([*steps, Instruction(leave, 0x7FFF0000)])
here = os.dup(1)
said = str(confine(Rules()))
os.write(here, f"{said}|{os.path.exists(__file__)}".encode())
try:
    open(__file__).read()
    os.write(here, b"|read")
except PermissionError:
    os.write(here, b"|not read")
"""


@fenced
@pytest.mark.parametrize(
    ("missing", "said"),
    [
        (["landlock"], "no Landlock, seccomp|True|read"),
        (["seccomp"], f"landlock {offered().landlock}, no seccomp|True|not read"),
        (["landlock", "seccomp"], "none: the system has neither Landlock nor seccomp|True|read"),
        ([], f"{offered()}|True|not read"),
    ],
    ids=["no landlock", "no seccomp", "neither", "both"],
)
def test_where_the_kernel_says_no_the_process_goes_on_and_says_so(tmp_path, missing, said):
    script = tmp_path / "script.py"
    script.write_text(WITHOUT)
    done = subprocess.run(
        [sys.executable, script, *missing], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, said, "")


def test_trying_the_fence_leaves_the_caller_outside(tmp_path):
    assert isinstance(offered(network="server"), Fence)
    (tmp_path / "file").write_text("x")
    subprocess.run([sys.executable, "-c", ""], check=True)
