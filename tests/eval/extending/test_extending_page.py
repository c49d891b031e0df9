"""docs/how-to/extending: its packages are those beside this file, installed by pip, and its
commands run as they stand there."""

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
FOLDER = ROOT / "docs" / "how-to" / "extending"
ORDER = ("robots", "tasks", "scores", "axes", "splat-formats", "reporters", "testing")
PAGES = {name: (FOLDER / f"{name}.md").read_text(encoding="utf-8") for name in ("index", *ORDER)}
PACKAGES = Path(__file__).parent / "packages"
HARNESS = ROOT / "harness" / "nw_eval"
BLOCK = re.compile(r"^```(\w+)(?: (\S+))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
SECTIONS = {name: BLOCK.findall(PAGES[name]) for name in ORDER}
"""What each page shows, in the order in which they are followed."""


class Reader:
    """Somebody who follows the page in a folder of their own.

    Args:
        folder: empty; `site` in it becomes what pip installs into.
    """

    def __init__(self, folder):
        self.folder, self.printed = folder, ""
        (folder / "site").mkdir()
        tools = str(Path(sys.executable).parent)
        self.environment = os.environ | {
            "PATH": tools + os.pathsep + os.environ["PATH"],
            "PYTHONPATH": os.pathsep.join([str(folder / "site"), os.environ.get("PYTHONPATH", "")]),
            "NW_EVAL_CACHE_GB": "0",
            "COLUMNS": "200",
            "PYTEST_ADDOPTS": "-p no:dash",  # Open3D's dash has a plugin that warns of itself.
        }

    def install(self, package):
        """Install a package with pip, from no index."""
        shutil.copytree(PACKAGES / package, self.folder / package, dirs_exist_ok=True)
        options = ["--no-index", "--no-build-isolation", "--no-deps", "--quiet"]
        self.run(f"python -m pip install {' '.join(options)} --target site ./{package}")

    def run(self, command, code=0):
        """Run a command; return what it printed."""
        done = subprocess.run(
            ["bash", "-ec", command],
            cwd=self.folder,
            env=self.environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == code, f"{command}\n{done.stdout}\n{done.stderr}"
        return done.stdout + done.stderr

    def follow(self, blocks):
        """Write files, run commands, and compare what is printed with what the page shows."""
        for kind, file, text in blocks:
            if file:
                (self.folder / file).parent.mkdir(parents=True, exist_ok=True)
                (self.folder / file).write_text(text)
            elif kind == "sh":
                self.printed = ""
                for line in text.splitlines():
                    installed = re.fullmatch(r"pip install \./(\S+)", line)
                    if installed:
                        self.install(installed[1])
                    else:
                        self.printed += self.run(line)
            elif kind == "text":
                lines = self.printed.splitlines()
                for shown in text.splitlines():
                    begins = shown.removesuffix("...")
                    assert any(
                        line.startswith(begins) if begins != shown else line == shown
                        for line in lines
                    ), f"{shown!r} is not in\n{self.printed}"


@pytest.fixture(scope="module")
def reader(tmp_path_factory):
    return Reader(tmp_path_factory.mktemp("reader"))


def test_the_packages_of_the_page_are_those_of_the_tests():
    shown = {file: text for blocks in SECTIONS.values() for _, file, text in blocks if "/" in file}
    real = {
        path.relative_to(PACKAGES).as_posix(): path.read_text(encoding="utf-8")
        for path in PACKAGES.rglob("*")
        if path.suffix in {".py", ".toml", ".xml", ".yaml"}
        and "build" not in path.relative_to(PACKAGES).parts
    }
    assert shown == real


def test_the_table_names_every_entry_point_group():
    from nw_base import plugins

    groups = {
        plugins.AXES,
        plugins.LADDERS,
        plugins.REPORTERS,
        plugins.ROBOTS,
        plugins.SCORES,
        plugins.SENSORS,
        plugins.SPLAT_FORMATS,
        plugins.TASKS,
        plugins.WRAPPERS,
    }
    assert set(re.findall(r"^\| `(nw_eval\.\w+)` \|", PAGES["index"], re.MULTILINE)) == groups
    for package in PACKAGES.iterdir():
        project = tomllib.loads((package / "pyproject.toml").read_text())["project"]
        assert set(project["entry-points"]) <= groups


def test_each_kind_of_extension_takes_one_source_file_in_a_package_of_its_own():
    from nw_base import plugins

    sources = {}
    for package in PACKAGES.iterdir():
        project = tomllib.loads((package / "pyproject.toml").read_text())["project"]
        (group,) = project["entry-points"]
        assert len(project["entry-points"][group]) == 1
        (source,) = (
            path
            for path in package.rglob("*.py")
            if not path.name.startswith("test_") and "build" not in path.parts
        )
        sources[group] = source
    # Of ladders.md and sensors.md, whose packages have tests of their own.
    linked = {plugins.LADDERS, plugins.SENSORS, plugins.WRAPPERS}
    groups = set(re.findall(r"^\| `(nw_eval\.\w+)` \|", PAGES["index"], re.MULTILINE))
    assert set(sources) == groups - linked


def test_its_reporters_are_those_that_are_built_in():
    from nw_eval.api.surfaces import REPORTERS

    said = PAGES["reporters"].partition("The built-in ones are ")[2].partition(";")[0]
    words = [word.partition("=")[0] for word in re.findall(r"`([^`]+)`", said)]
    assert words == list(REPORTERS)


@pytest.mark.slow
@pytest.mark.parametrize(
    "pages",
    [
        ("robots",),
        ("splat-formats",),
        # The other files of this folder test by day what these show.
        pytest.param(("tasks",), marks=pytest.mark.nightly),
        pytest.param(("scores",), marks=pytest.mark.nightly),
        # The later ones go on with what the first has left.
        pytest.param(("axes", "reporters", "testing"), marks=pytest.mark.nightly),
    ],
    ids=" ".join,
)
def test_the_commands_of_a_page_do_what_it_says_and_change_no_file_of_ours(reader, pages):
    before = {path: path.read_bytes() for path in HARNESS.rglob("*.py")}
    for page in pages:
        reader.follow(SECTIONS[page])
    assert {path: path.read_bytes() for path in HARNESS.rglob("*.py")} == before


def test_the_page_tells_all_that_is_there_for_tests():
    from nw_eval import testing

    told = re.findall(r"^\| `(\w+)[^`]*` \|", PAGES["testing"], re.MULTILINE)
    assert sorted(told) == testing.__all__
