"""No OpenGL is needed, whatever the environment says of it."""

import os
import subprocess
import sys

import pytest

SHOW = """
import os
from nw_eval.cli import main
try:
    main(["robots", "show", "go1"])
finally:
    print(os.environ["MUJOCO_GL"])
"""


@pytest.mark.parametrize("named", ["osmesa", "wgl", "nonsense", "egl", " GLFW ", "off"])
def test_mujoco_is_imported_whichever_opengl_is_named(named):
    environment = os.environ | {"MUJOCO_GL": named}
    verb = [sys.executable, "-c", SHOW]
    done = subprocess.run(verb, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert "go1" in done.stdout
    assert done.stdout.splitlines()[-1].strip() == named.strip()
