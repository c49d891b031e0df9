"""Install the built wheel alone and run the smoke suite where there is no checkout.

Run by `make build` as `python tests/smoke_wheel.py dist`.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import venv
from pathlib import Path


def main(dist: Path) -> None:
    (wheel,) = dist.resolve().glob("*.whl")
    constraints = Path(__file__).resolve().parents[1] / "constraints.txt"
    (torch,) = [line for line in constraints.read_text().splitlines() if line.startswith("torch==")]
    with tempfile.TemporaryDirectory() as place:
        venv.create(Path(place, "venv"), with_pip=True)
        binaries = Path(place, "venv", "bin")
        pip = [str(binaries / "pip"), "install", "-q", "--disable-pip-version-check"]
        subprocess.run([*pip, torch], check=True)
        subprocess.run([*pip, "-c", str(constraints), str(wheel)], check=True)
        for arguments in (
            ["--version"],
            ["check", "smoke"],
            ["baseline", "list"],
            ["run", "smoke", "--trials", "1", "--out", str(Path(place, "out"))],
        ):
            code = subprocess.run(
                [str(binaries / "nw-eval"), *arguments], cwd=place, check=False
            ).returncode
            # Two trials rarely decide a gate: INCONCLUSIVE (3) is a working installation too.
            if code not in (0, 3):
                sys.exit(f"nw-eval {' '.join(arguments)} left with exit code {code}")
        for name in ("trials.parquet", "report.md", "report.html", "run.json"):
            if not Path(place, "out", name).is_file():
                sys.exit(f"the wheel's run wrote no {name}")
    print(f"{wheel.name}: installed alone, ran the smoke suite")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
