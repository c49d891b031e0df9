"""Use what was built where there is no checkout: the wheels alone, and those of the archive.

Run by `make build` as `python tests/smoke_wheel.py dist`.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tarfile
import tempfile
import venv
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CONSTRAINTS = ROOT / "constraints.txt"

INI = "pytest.ini"
"""The project's own asks for plugins of pytest's that the wheel does not bring."""

COMMANDS: tuple[tuple[tuple[int, ...], str], ...] = (
    ((0,), "nw-eval --version"),
    ((0,), "nw-eval check smoke"),
    ((0,), "nw-eval baseline list"),
    # Two trials rarely decide a gate: INCONCLUSIVE (3) is a working installation too.
    ((0, 3), "nw-eval run smoke --trials 1 --out out"),
    ((0, 3), "nw-eval gate out --junit junit.xml"),
    # pytest comes beside the wheel, which brings the plugin.
    ((0,), "python -m pip install -q --disable-pip-version-check pytest"),
    ((0,), f"pytest -q -c {INI} {ROOT}/suites/smoke.yaml --nw-rounds 1 -o nw_inconclusive=pass"),
    # The shell steps of the action, with this nw-eval.
    (
        (0,),
        (
            f"pytest -q -c {INI} --confcutdir {ROOT}/tests/workflows "
            f"{ROOT}/tests/workflows/test_action.py -m not(nightly)"
        ),
    ),
)
"""What the wheel alone is asked to do, one after another in one empty folder, and how it may end.

Words between spaces; none needs a shell.
"""

ALONE = {
    "nw-base": "import nw_base.errors, nw_base.files.cache, nw_base.trials",
    "nw-splat": """
import sys, numpy as np
from nw_splat import Camera, CpuRenderer, Gaussians, memory_store
one = Gaussians(
    means=np.array([[0, 0, 2]], np.float32), log_scales=np.full((1, 3), -1, np.float32),
    quats=np.array([[1, 0, 0, 0]], np.float32), opacity_logits=np.zeros(1, np.float32),
    sh=np.zeros((1, 4, 3), np.float32),
)
camera = Camera.from_fovy(width=16, height=16, fovy=1.0, T_world_camera=np.eye(4))
assert CpuRenderer(memory_store(one)).render(camera).rgb.shape == (16, 16, 3)
assert not {"mujoco", "torch", "pandas", "nw_eval", "nw_gate"} & {*sys.modules}
""",
    "nw-gate": """
import sys, pathlib
rows = "task,seed,success\\n" + "".join(f"lift,{i},{i % 5 > 0:d}\\n" for i in range(400))
pathlib.Path("rows.csv").write_text(rows)
from nw_gate import judge, read_evaluation
found = judge(read_evaluation("rows.csv"), read_evaluation("rows.csv"))
assert (found.word, found.drop) == ("PASS", 0.0), found
assert not {"mujoco", "torch", "numba", "nw_eval", "nw_splat"} & {*sys.modules}
""",
}
"""What packages are asked that are of use without nw-eval, in an environment of their own."""

WRITTEN = ("out/trials.parquet", "out/report.md", "out/report.html", "out/run.json", "junit.xml")
"""What those commands leave behind."""


def main(dist: Path) -> None:
    wheels = {wheel.name: wheel for wheel in dist.resolve().glob("*.whl")}
    (archive,) = dist.resolve().glob("*.tar.gz")
    with tempfile.TemporaryDirectory() as place:
        others = wheels_of(archive, Path(place, "archive"))
        if wheels.keys() != others.keys():
            sys.exit(f"the archive makes {sorted(others)}, and dist has {sorted(wheels)}")
        for name, wheel in wheels.items():
            compare(wheel, others[name])
        use(install(dist.resolve(), Path(place, "venv")), Path(place, "work"))
        for name, command in ALONE.items():
            alone(name, command, dist.resolve(), Path(place, name))
    print(f"{len(wheels)} wheels: the archive's too; nw-eval alone ran the smoke suite")


def wheels_of(archive: Path, place: Path) -> dict[str, Path]:
    """Return the wheels that the archive's own files make, by name."""
    with tarfile.open(archive) as packed:
        # Python 3.11.2 has no filters yet; the archive is our own.
        safe = {"filter": "data"} if hasattr(tarfile, "data_filter") else {}
        packed.extractall(place, **safe)
    (source,) = place.iterdir()
    build = [sys.executable, "-m", "build", "--no-isolation", "--wheel", "--outdir", str(place)]
    for project in (source, *(file.parent for file in source.glob("harness/*/pyproject.toml"))):
        subprocess.run([*build, str(project)], check=True, stdout=subprocess.DEVNULL)
    return {wheel.name: wheel for wheel in place.glob("*.whl")}


def compare(one: Path, other: Path) -> None:
    """Refuse two wheels of different bytes, by the names of the files that differ."""
    if one.read_bytes() == other.read_bytes():
        return
    with zipfile.ZipFile(one) as first, zipfile.ZipFile(other) as second:
        entries = [
            {info.filename: info.CRC for info in file.infolist()} for file in (first, second)
        ]
    names = sorted({name for name, _ in entries[0].items() ^ entries[1].items()})
    sys.exit(f"{one.name}: the archive makes another wheel: {', '.join(names) or 'other bytes'}")


def install(dist: Path, place: Path, name: str = "nw-eval") -> Path:
    """Return the folder of programs of a new environment that has one package and what it needs.

    That is the line that a user of a release types: all wheels lie in one folder.
    """
    venv.create(place, with_pip=True)
    pip = [str(place / "bin" / "pip"), "install", "-q", "--disable-pip-version-check"]
    elsewhere = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    command = [*pip, "-c", str(CONSTRAINTS), "--find-links", str(dist), name]
    subprocess.run(command, check=True, env=elsewhere)
    return place / "bin"


def alone(name: str, program: str, dist: Path, place: Path) -> None:
    """Run a program in an environment that has one package alone, and count what came with it."""
    programs = install(dist, place, name)
    done = subprocess.run([str(programs / "python"), "-c", program], check=False, cwd=place)
    if done.returncode:
        sys.exit(f"{name} alone left with exit code {done.returncode}")


def use(programs: Path, folder: Path) -> None:
    """Run the commands in an empty folder, with an empty cache and no variables of this process."""
    folder.mkdir()
    (folder / INI).write_text("[pytest]\nmarkers =\n    nightly: takes minutes\n")
    environment = {
        "PATH": os.pathsep.join((str(programs), os.defpath)),
        "HOME": str(folder.parent),
        "NW_EVAL_CACHE": str(folder.parent / "cache"),
    }
    for codes, command in COMMANDS:
        program, *arguments = command.split()
        code = subprocess.run(
            [str(programs / program), *arguments], cwd=folder, env=environment, check=False
        ).returncode
        if code not in codes:
            sys.exit(f"{command} left with exit code {code}")
    for name in WRITTEN:
        if not (folder / name).is_file():
            sys.exit(f"the wheel's run wrote no {name}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
