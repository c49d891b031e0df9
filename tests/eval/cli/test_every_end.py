"""However a verb ends, the exit code is true, there is one line, and no traceback on a screen."""

import errno
import os
import random
import re
import shlex
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from command_line import ends

from nw_eval.cli.terminal.interruption import interruption

NW_EVAL = [sys.executable, "-c", "from nw_eval.cli import main; main()"]
CODE_OF_REGRESSED = 1


def end_of(argv, **settings):
    return subprocess.run(argv, check=False, stderr=subprocess.PIPE, text=True, **settings)


def full():
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "cache/scene")


def deep():
    return deep()


def raising(error):
    def verb(*_, **__):
        raise error

    return verb


ENDS = {
    "exit-0": raising(SystemExit(0)),
    "exit-1": raising(SystemExit(1)),
    "exit-none": raising(SystemExit),
    "generator": raising(GeneratorExit()),
    "memory": raising(MemoryError()),
    "key": raising(KeyError("a\nTraceback (most recent call last)\x1b[2J")),
    "pipe": raising(BrokenPipeError(errno.EPIPE, "a policy server left")),
    "disk": lambda *_, **__: full(),
    "depth": lambda *_, **__: deep(),
    "no code": lambda *_, **__: None,
}


@pytest.mark.parametrize("end", ENDS)
def test_what_nobody_foresaw_is_4_with_one_line_and_its_traceback_in_a_file(
    capsys, monkeypatch, tmp_path, end
):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr("nw_eval.cli.verbs.scenes.List.__call__", ENDS[end])
    assert ends("scenes", "list") == 4
    said = capsys.readouterr()
    assert said.out == ""
    assert re.fullmatch(r"error: unforeseen: \w+: .*; traceback: \S+\n", said.err)
    assert "\x1b" not in said.err
    [kept] = tmp_path.iterdir()
    assert str(kept) in said.err
    assert kept.read_text().startswith("Traceback (most recent call last)")
    assert kept.stat().st_mode & 0o077 == 0, "a traceback may hold what others should not read"


def test_a_traceback_without_room_costs_the_traceback_only(capsys, monkeypatch, tmp_path):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "missing"))
    monkeypatch.setattr("nw_eval.cli.verbs.scenes.List.__call__", ENDS["disk"])
    assert ends("scenes", "list") == 4
    assert "No space left on device" in (said := capsys.readouterr().err)
    assert "no room for its traceback" in said


def test_an_exception_that_cannot_be_printed_is_4_too(capsys, monkeypatch):
    class MuteError(Exception):
        def __str__(self):
            raise RuntimeError("no words")

    monkeypatch.setattr("nw_eval.cli.verbs.scenes.List.__call__", raising(MuteError()))
    assert ends("scenes", "list") == 4
    assert capsys.readouterr().err == "error: unforeseen, and without a message that can be read\n"


def test_an_interruption_is_130_and_one_word(capsys, monkeypatch):
    monkeypatch.setattr("nw_eval.cli.verbs.scenes.List.__call__", raising(KeyboardInterrupt()))
    assert ends("scenes", "list") == 130
    assert capsys.readouterr().err == "interrupted\n"


def test_an_interruption_that_a_library_disguises_is_130_too(capsys, monkeypatch):
    monkeypatch.setattr(interruption, "was_heard", True)
    disguised = raising(ImportError("numpy failed to import"))
    monkeypatch.setattr("nw_eval.cli.verbs.scenes.List.__call__", disguised)
    assert ends("scenes", "list") == 130
    assert capsys.readouterr().err == "interrupted\n"


def test_a_run_that_is_interrupted_ends_with_130_and_says_how_to_go_on(
    capsys, monkeypatch, regressed_run, tmp_path
):
    def press_ctrl_c(*_):
        os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr("nw_eval.cli.terminal.progress.RunProgress.trial", press_ctrl_c)
    suite, out = regressed_run.parent / "suite.yaml", tmp_path / "run"
    assert ends("run", suite, "--out", out, "--workers", "1") == 130
    said = capsys.readouterr()
    assert f"interrupted; continue with --resume {out}" in said.err
    assert "1 of 2 ran in 1 scene" in " ".join(said.out.split())
    monkeypatch.undo()
    assert ends("run", "--resume", out, "--workers", "1") == CODE_OF_REGRESSED


def test_a_progress_display_that_breaks_costs_the_display_and_nothing_else(capsys, monkeypatch):
    from nw_eval.cli.terminal.progress import RunProgress

    monkeypatch.setattr("rich.console.Console.print", raising(RuntimeError("no terminal")))
    with RunProgress() as progress:
        progress.message("one")
        progress.planned(total=2, finished=1)
    [line] = capsys.readouterr().err.splitlines()
    assert line.startswith("warning: no more progress is shown, unforeseen: RuntimeError")


@pytest.mark.nightly
def test_a_verdict_stands_whatever_becomes_of_its_print(regressed_run):
    argv = [*NW_EVAL, "report", str(regressed_run)]
    with Path("/dev/full").open("wb") as no_room:
        left = end_of(argv, stdout=no_room)
    assert left.returncode == CODE_OF_REGRESSED
    assert left.stderr == "error: cannot write to standard output: No space left on device\n"
    for shell in ("exec {} >&-", "exec {} >&- 2>&- <&-", "exec {} >/dev/full 2>&1"):
        line = shell.format(shlex.join(argv))
        left = end_of(line, shell=True)
        assert (left.returncode, left.stderr) == (CODE_OF_REGRESSED, ""), shell
    reader, writer = os.pipe()
    os.close(reader)
    left = end_of(argv, stdout=writer)
    os.close(writer)
    assert (left.returncode, left.stderr) == (CODE_OF_REGRESSED, "")


@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_a_verdict_stands_on_a_screen_that_lacks_its_letters(regressed_run, encoding):
    left = end_of(
        [*NW_EVAL, "gate", str(regressed_run)],
        env={**os.environ, "PYTHONIOENCODING": encoding},
        stdout=subprocess.PIPE,
        encoding=encoding,
    )
    assert (left.returncode, left.stderr) == (CODE_OF_REGRESSED, "")
    assert "REGRESSED" in left.stdout
    assert "-----" in left.stdout, "rules are drawn with what there is"


def test_words_that_stand_nowhere_else_need_a_screen(tmp_path):
    argv = [*NW_EVAL, "scenes", "list", "flat/*"]
    with Path("/dev/full").open("wb") as no_room:
        left = end_of(argv, stdout=no_room)
    assert left.returncode == 4
    assert left.stderr == "error: cannot write to standard output: No space left on device\n"
    reader, writer = os.pipe()
    os.close(reader)
    left = end_of(argv, stdout=writer)
    os.close(writer)
    assert (left.returncode, left.stderr) == (0, ""), "a reader that leaves has what it wanted"
    with (tmp_path / "help").open("wb") as out:
        left = end_of([*NW_EVAL, "--help"], stdout=out)
    assert (left.returncode, left.stderr) == (0, "")


@pytest.mark.parametrize(
    "argv",
    [["replay", "{run}"], ["run", "--resume", "{folder}"], ["report", "{folder}"]],
    ids=["replay", "resume", "report"],
)
def test_a_path_that_is_not_what_the_verb_takes_is_a_usage_error(capsys, regressed_run, argv):
    named = [word.format(run=regressed_run, folder=regressed_run.parent) for word in argv]
    assert ends(*named) == 2
    [line] = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ")


def listens(process):
    """Say whether a process has come to its first line: it then handles SIGTERM."""
    for line in Path(f"/proc/{process.pid}/status").read_text().splitlines():
        if line.startswith("SigCgt"):
            return bool(int(line.split()[1], 16) >> (signal.SIGTERM - 1) & 1)
    return False


def test_ctrl_c_at_any_moment_of_the_start_is_130_without_a_traceback():
    moments = random.Random(9)
    codes = []
    for _ in range(5):
        process = subprocess.Popen(
            [*NW_EVAL, "check", "smoke"],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        while process.poll() is None and not listens(process):
            time.sleep(0.001)
        time.sleep(moments.random() * 0.8)
        os.killpg(process.pid, signal.SIGINT)
        out, err = process.communicate(timeout=60)
        assert (out, err) in {("", "interrupted\n"), (out, "")}, err
        codes.append(process.returncode)
    assert set(codes) <= {0, 130}
    assert 130 in codes


THREAD = """
import threading, weakref
from nw_eval.cli import main
from nw_eval.cli.verbs import scenes

class Fragile:
    def __del__(self):
        raise ValueError("finaliser")

def verb(self):
    thread = threading.Thread(target=lambda: 1 / 0)
    thread.start()
    thread.join()
    Fragile()
    return 0

scenes.List.__call__ = verb
import sys
sys.argv = ["nw-eval", "scenes", "list"]
main()
"""


def test_what_threads_and_finalisers_raise_is_told_in_a_line(tmp_path):
    left = end_of(
        [sys.executable, "-c", THREAD],
        stdout=subprocess.PIPE,
        env={**os.environ, "TMPDIR": str(tmp_path)},
    )
    assert (left.returncode, left.stdout) == (0, "")
    thread, finaliser = left.stderr.splitlines()
    assert thread.startswith("warning: a thread failed, unforeseen: ZeroDivisionError")
    assert finaliser.startswith("warning: unforeseen: ValueError: finaliser")
    assert len(list(tmp_path.iterdir())) == 2, "both tracebacks are kept"


def test_main_within_another_program_leaves_its_signals_and_hooks_alone(capsys):
    before = signal.getsignal(signal.SIGINT), threading.excepthook, sys.unraisablehook, sys.stdout
    assert ends("--version") == 0
    assert capsys.readouterr().out.startswith("nw-eval ")
    after = signal.getsignal(signal.SIGINT), threading.excepthook, sys.unraisablehook, sys.stdout
    assert after == before
