"""No OpenGL is needed, whatever the environment says of it."""

import os
import subprocess
import sys

import pytest

SHOW = "from nw_eval import api; api.show_robot('go1'); import os; print(os.environ['MUJOCO_GL'])"


@pytest.mark.parametrize("named", ["osmesa", "wgl", "nonsense", "egl", " GLFW ", "off"])
def test_mujoco_is_imported_whichever_opengl_is_named(named):
    environment = os.environ | {"MUJOCO_GL": named}
    verb = [sys.executable, "-m", "nw_eval", "robots", "show", "go1"]
    asked = subprocess.run(verb, env=environment, capture_output=True, text=True, check=False)
    assert (asked.returncode, asked.stderr) == (0, "")
    code = [sys.executable, "-c", SHOW]
    called = subprocess.run(code, env=environment, capture_output=True, text=True, check=False)
    assert (called.returncode, called.stdout.strip()) == (0, named.strip()), called.stderr
