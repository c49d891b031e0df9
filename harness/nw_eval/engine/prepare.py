"""Builds what all workers will need, once, before the first of them starts."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from time import perf_counter
from typing import TYPE_CHECKING

from nw_eval.errors import UsageError
from nw_eval.rollout.confined.start import has_kernels, renew
from nw_eval.scenes.scene import HeightField, Triangles
from nw_eval.words import KERNELS

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable

    from nw_eval.cards import Card
    from nw_eval.engine.listener import Listener
    from nw_eval.scenes import Scene
    from nw_eval.words import Backend, Kernels, Record

_WORTH_SAYING = 3.0  # s


def needs_splats(card: Card, record: Record) -> bool:
    """Return whether any trial may render: for the policy's eyes or for the log."""
    return bool(card.splat_images) or record in {"all", "failures"}


def check_splats(card: Card, scenes: Iterable[Scene]) -> None:
    """Refuse scenes without a splat to a policy that must see one.

    Raises:
        UsageError: naming the scenes, and what of the card cannot be made there.
    """
    names, without = card.splat_images, [s.name for s in scenes if s.splat is None]
    if names and without:
        raise UsageError(
            f"{', '.join(without)}: no splat, of which policy {card.name!r} needs images: "
            f"{', '.join(f'`{name}`' for name in names)}",
            fix="use a policy that sees no splat, or add a splat file to the scene folder",
        )


def open_backend(
    render: Backend,
    listener: Listener,
    *,
    is_fenced: bool,
    surfaces: bool = False,
    kernels: Collection[Kernels] = KERNELS,
    beside: AbstractContextManager[None] | None = None,
) -> None:
    """Compile the renderer once for all workers, or find out that it is missing.

    Args:
        render: the splat renderer.
        listener: hears what took long.
        is_fenced: whether workers are forked, with kernels if there are any.
        surfaces: whether rays meet splats, which has kernels of its own.
        kernels: which of the CPU's are needed.
        beside: entered where anything has to be compiled, and left when it has been.

    Raises:
        PrerequisiteError: the backend's packages or device are missing.
    """
    if is_fenced and render == "cpu" and has_kernels(kernels) and not surfaces:
        return
    from nw_eval.splat.warmup import kernel_note, warmup

    with beside or nullcontext():
        seconds = warmup(render, surfaces=surfaces, kernels=kernels)
    renew()
    note = kernel_note() if render == "cpu" else None
    if note is not None:
        listener.message(note)
    elif seconds > _WORTH_SAYING:
        listener.message(f"compiled the renderer in {seconds:.0f} s; next time it is in the cache")


def ready_scans(scenes: Iterable[Scene], listener: Listener) -> None:
    """Compile what collides with scans, once for all workers, if any scene is one.

    Raises:
        PrerequisiteError: this build of MuJoCo is not laid out as any that is known.
    """
    if not any(isinstance(s, HeightField | Triangles) for scene in scenes for s in scene.solids):
        return
    from nw_eval.scenes.narrowphase.install import use_own_collisions

    began = perf_counter()
    use_own_collisions()
    seconds = perf_counter() - began
    if seconds > _WORTH_SAYING:
        listener.message(f"compiled contacts in {seconds:.0f} s; next time they are in the cache")


def needs_splats_first(card: Card, record: Record) -> bool:
    """Return whether trials draw as they run: otherwise only those that failed do, at their end."""
    return bool(card.splat_images) or card.meets_splat or record == "all"


def build_splats(scenes: Iterable[Scene], listener: Listener) -> None:
    """Make the compiled splat of every scene that has one and that the cache does not hold yet.

    Raises:
        SceneError: a splat cannot be made.
    """
    for scene in scenes:
        if scene.splat is not None or scene.props:
            name = scene.name

            def progress(_stage: str, fraction: float, name: str = name) -> None:
                listener.scene(name, fraction)

            scene.splat_stores(progress)
