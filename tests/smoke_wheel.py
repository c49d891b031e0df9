"""Use what was built where there is no checkout: the wheel alone, and the wheel of the archive.

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

WRITTEN = ("out/trials.parquet", "out/report.md", "out/report.html", "out/run.json", "junit.xml")
"""What those commands leave behind."""


def main(dist: Path) -> None:
    (wheel,) = dist.resolve().glob("*.whl")
    (archive,) = dist.resolve().glob("*.tar.gz")
    with tempfile.TemporaryDirectory() as place:
        compare(wheel, wheel_of(archive, Path(place, "archive")))
        use(install(wheel, Path(place, "venv")), Path(place, "work"))
    print(f"{wheel.name}: the archive's too, installed alone, ran the smoke suite")


def wheel_of(archive: Path, place: Path) -> Path:
    """Return the wheel that the archive's own files make."""
    with tarfile.open(archive) as packed:
        # Python 3.11.2 has no filters yet; the archive is our own.
        safe = {"filter": "data"} if hasattr(tarfile, "data_filter") else {}
        packed.extractall(place, **safe)
    (source,) = place.iterdir()
    build = [sys.executable, "-m", "build", "--wheel", "--outdir", str(place), str(source)]
    subprocess.run(build, check=True, stdout=subprocess.DEVNULL)
    (wheel,) = place.glob("*.whl")
    return wheel


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


def install(wheel: Path, place: Path) -> Path:
    """Return the folder of programs of a new environment that has the wheel and nothing else."""
    (torch,) = [line for line in CONSTRAINTS.read_text().splitlines() if line.startswith("torch==")]
    venv.create(place, with_pip=True)
    pip = [str(place / "bin" / "pip"), "install", "-q", "--disable-pip-version-check"]
    elsewhere = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    subprocess.run([*pip, torch], check=True, env=elsewhere)
    subprocess.run([*pip, "-c", str(CONSTRAINTS), str(wheel)], check=True, env=elsewhere)
    return place / "bin"


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
