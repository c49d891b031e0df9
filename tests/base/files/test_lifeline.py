"""Helpers that end with the process that started them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

PROGRAM = [sys.executable, "-m", "nw_base.files.lifeline", "busy"]


def started(tmp_path, source):
    (tmp_path / "busy.py").write_text(source)
    line, ours = os.pipe()
    helper = subprocess.Popen(
        PROGRAM, stdin=line, stdout=subprocess.PIPE, env={**os.environ, "PYTHONPATH": str(tmp_path)}
    )
    os.close(line)
    return helper, ours


def test_a_helper_ends_in_the_midst_of_its_work_when_nobody_holds_its_line(tmp_path):
    helper, ours = started(tmp_path, "print('begun', flush=True)\nwhile True:\n    pass\n")
    assert helper.stdout.readline() == b"begun\n"
    os.close(ours)
    helper.communicate()
    assert helper.returncode == -signal.SIGIO


def test_a_helper_whose_line_was_let_go_before_it_looked_does_nothing(tmp_path):
    helper, ours = started(tmp_path, "print('begun', flush=True)\n")
    os.close(ours)
    said, _ = helper.communicate()
    assert (said, helper.returncode) in {(b"", 1), (b"", -signal.SIGIO)}


def test_a_helper_whose_line_is_held_does_its_work(tmp_path):
    helper, ours = started(tmp_path, "import sys\nprint(len(sys.argv))\n")
    said, _ = helper.communicate()
    os.close(ours)
    assert (said, helper.returncode) == (b"2\n", 0)
