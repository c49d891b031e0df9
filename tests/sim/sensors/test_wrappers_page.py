"""Does what docs/how-to/extending/sensors.md says, word for word."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[3] / "docs" / "how-to" / "extending" / "sensors.md"
BLOCK = re.compile(r"^```(\w+)(?: (\S+))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def install(package):
    """Make what `pip install` leaves of a package: its modules and its entry points."""
    project = tomllib.loads((package / "pyproject.toml").read_text())["project"]
    info = package / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    info.mkdir(exist_ok=True)
    name, version = project["name"], project["version"]
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    groups = [
        f"[{group}]\n" + "".join(f"{key} = {value}\n" for key, value in points.items())
        for group, points in project["entry-points"].items()
    ]
    (info / "entry_points.txt").write_text("\n".join(groups))


@pytest.fixture
def shell(tmp_path):
    """A function that runs a command in the reader's folder and returns what it prints."""
    tools = str(Path(sys.executable).parent)
    environment = os.environ | {
        "PATH": tools + os.pathsep + os.environ["PATH"],
        "PYTHONPATH": os.pathsep.join(["my-package", os.environ.get("PYTHONPATH", "")]),
        "COLUMNS": "200",
    }

    def run(command):
        if (tmp_path / "my-package" / "beam.py").exists():
            install(tmp_path / "my-package")
        done = subprocess.run(
            ["bash", "-ec", command],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
        return done.stdout + done.stderr

    return run


@pytest.mark.slow
@pytest.mark.nightly
def test_the_worked_example_works_as_it_is_written(tmp_path, shell):
    blocks = BLOCK.findall(PAGE.read_text(encoding="utf-8"))
    assert [kind for kind, _, _ in blocks].count("sh") >= 4
    printed = ""
    for kind, file, text in blocks:
        if file:
            path = tmp_path / file
            path.parent.mkdir(exist_ok=True)
            path.write_text(text)
        elif kind == "sh":
            printed = shell(text)
        else:
            assert kind == "text", f"what is done with a block of {kind}?"
            lines = printed.splitlines()
            for shown in text.splitlines():
                begins = shown.removesuffix(" ...")
                assert any(x.startswith(begins) if begins != shown else x == shown for x in lines)
    assert (tmp_path / "seen.png").stat().st_size > 1000
    assert (tmp_path / "beam.png").stat().st_size > 1000
    listed = shell("nw-eval sensors --list")
    assert "diffuse of my-package" in listed
    assert "beam of my-package" in listed


def test_the_page_names_every_built_in_wrapper_and_sensor():
    from nw_policies.cards.observations import BUILT_IN_SENSORS
    from nw_policies.cards.wrappers import BUILT_IN_WRAPPERS

    page = (PAGE.parents[2] / "reference" / "sensors.md").read_text(encoding="utf-8")
    for name in (*BUILT_IN_WRAPPERS, *BUILT_IN_SENSORS):
        assert f"| `{name}` |" in page
