"""The folder of a build, and which of its results are still valid."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Generator, Iterable
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Literal, get_args

from nw_base.errors import SceneError, StoreError, UsageError
from nw_base.files.cache import atomic_path, made_folder, unwritable
from nw_base.files.inside import regular

Stage = Literal["calibrate", "reconstruct", "align", "splat", "place"]
STAGES: tuple[Stage, ...] = get_args(Stage)
"""In the order in which they run."""
_READ_BY: dict[Stage, tuple[Stage, ...]] = {"align": ("align", "place")}
"""Which stages read what one has left, itself among them; all that come later where none are named.
Another scale needs no other splat."""

_FORMATS: dict[Stage, int] = {
    "calibrate": 5,
    "reconstruct": 7,
    "align": 5,
    "splat": 7,
    "place": 10,
}
"""Each changes with what its stage makes of the same inputs."""
_MOST_BYTES = 1_000_000
"""Of a stamps.json that is read."""


class BuildFolder:
    """`<scene>/build/`: the results of the stages, with stamps of their inputs.

        capture/      photographs without distortion, and where they were taken from
        mesh/         depths and the mesh, in the capture's frame
        align.json    from the capture's frame to metres
        splat/        the Gaussians, in the capture's frame
        page.html     pictures of it, and how well it is known
        trail.json    roughness, steps, slopes and differences from the depths along the course
        stamps.json   by stage, a digest of all that its result depends on

    Args:
        scene: the scene's folder.
    """

    def __init__(self, scene: Path) -> None:
        self.scene = scene
        self.path = scene / "build"
        self.capture = self.path / "capture"
        self.mesh = self.path / "mesh"
        self.splat = self.path / "splat"
        self.align = self.path / "align.json"
        self._is_held = False
        self.trail = self.path / "trail.json"
        self.page = self.path / "page.html"
        self._results: dict[Stage, Path] = {
            "calibrate": self.capture / "capture.json",
            "reconstruct": self.mesh / "mesh.ply",
            "align": self.align,
            "splat": self.splat / "splat.ply",
            "place": scene / "scene.yaml",
        }

    @contextmanager
    def held(self) -> Generator[None]:
        """Keep other processes from building here; a file system without locks keeps none.

        Within itself it does nothing.

        Raises:
            UsageError: another process builds here; or no folder can be made.
            StoreError: the folder cannot be made.
        """
        import fcntl  # Not on Windows, where nothing is built.

        if self._is_held:
            yield
            return
        with ExitStack() as stack:
            try:
                stack.enter_context(made_folder(self.path))
                handle = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
            except OSError as error:
                raise unwritable(self.path, error) from None
            stack.callback(os.close, handle)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise UsageError(
                    f"{self.scene} is being built by {_holder(handle)}",
                    fix="wait for it or stop it, or choose another --out",
                ) from None
            except OSError:  # A file system without locks.
                pass
            self._is_held = True
            try:
                yield
            finally:
                self._is_held = False

    def carry_out(
        self,
        stage: Stage,
        depends_on: Iterable[str],
        work: Callable[[], object],
        say: Callable[[str], None],
    ) -> bool:
        """Do the work of a stage, unless its result is there and of the same things.

        Args:
            stage: which.
            depends_on: texts and digests that with the stage's name decide its result.
            work: leaves the result; it goes on by itself where it was cut off.
            say: takes a line for people.

        Returns:
            Whether anything was done.

        Raises:
            NwEvalError: as `work`; after a UsageError the results of before still hold.
            StoreError: the stamps cannot be written.
        """
        with self.held():
            return self._carry_out(stage, depends_on, work, say)

    def _carry_out(
        self,
        stage: Stage,
        depends_on: Iterable[str],
        work: Callable[[], object],
        say: Callable[[str], None],
    ) -> bool:
        content = json.dumps([_FORMATS[stage], stage, *depends_on])
        stamp = hashlib.sha256(content.encode()).hexdigest()
        stamps = self._stamps()
        if stamps.get(stage) == stamp and self._results[stage].is_file():
            say(f"{stage}: done before, of the same things")
            return False
        # What comes later is of another result from now on.
        later = _READ_BY.get(stage, STAGES[STAGES.index(stage) :])
        kept = {name: old for name, old in stamps.items() if name not in later}
        if kept != stamps:
            self._write(kept)
        try:
            work()
        except UsageError:  # It was refused, so that what was there before still holds.
            if kept != stamps:
                self._write(stamps)
            raise
        self._write(self._stamps() | {stage: stamp})
        return True

    def needs(self, stage: Stage) -> None:
        """Refuse to go on without the result of a stage.

        Raises:
            SceneError: it is not there, or was cut off.
        """
        if stage not in self._stamps() or not self._results[stage].is_file():
            raise SceneError(
                f"{self.scene} has no result of `{stage}`, or it was cut off or removed",
                fix=f"nw-eval twin {stage} {self.scene}",
            )

    def _stamps(self) -> dict[str, str]:
        path = self.path / "stamps.json"
        try:
            if regular(path).stat().st_size > _MOST_BYTES:
                raise SceneError(f"{path} is too large", fix="remove it: all stages run again")
            content = json.loads(path.read_bytes())
        except FileNotFoundError:
            return {}
        except (OSError, ValueError, RecursionError) as error:
            raise SceneError(
                f"{path} cannot be read: {error}", fix="remove it: all stages run again"
            ) from None
        if not isinstance(content, dict):
            return {}
        return {str(k): str(v) for k, v in content.items()}  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]

    def _write(self, stamps: dict[str, str]) -> None:
        with atomic_path(self.path / "stamps.json") as temporary:
            temporary.write_text(json.dumps(stamps, indent=1), encoding="utf-8")


def _holder(handle: int) -> str:
    """Return who holds the lock of an open folder, as Linux lists it."""
    with suppress(OSError, ValueError, IndexError):
        inode = os.fstat(handle).st_ino
        for line in Path("/proc/locks").read_text(encoding="ascii").splitlines():
            words = line.split()
            if words[1] == "FLOCK" and int(words[5].rpartition(":")[2]) == inode and words[4] > "0":
                return f"process {words[4]}"
    return "another process"


def digest_of_files(*paths: Path) -> str:
    """Return a digest of the names and bytes of files, and of all files in folders among them.

    Raises:
        StoreError: one cannot be read.
    """
    whole = hashlib.sha256()
    for path in paths:
        files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
        for file in files:
            try:
                with regular(file).open("rb") as opened:
                    content = hashlib.file_digest(opened, "sha256").hexdigest()
            except OSError as error:
                raise StoreError(
                    f"{file} cannot be read: {error.strerror}", fix="check the path"
                ) from None
            name = file.name if file == path else file.relative_to(path).as_posix()
            whole.update(json.dumps([name, content]).encode())
    return whole.hexdigest()
