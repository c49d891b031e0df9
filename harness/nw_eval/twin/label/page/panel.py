"""What the page's panel is built of: buttons that have keys, and fields that follow the state."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

Run = Callable[[Callable[[], object]], None]
"""Runs an action, shows what it changed, or why it could not."""

Entry = tuple[str, str | None, str | None, Callable[[], object]]
"""A button in a row: name, key, modifier, and what it does."""


class ControlPanel:
    """Adds buttons to viser's panel, all of them in the list of commands too (Ctrl+K).

    Args:
        gui: viser's.
        run: wraps every action.

    Attributes:
        gui: as above.
        by_name: what was added, by its label.
    """

    def __init__(self, gui: Any, run: Run) -> None:
        self.gui = gui
        self._run = run
        self.by_name: dict[str, Any] = {}

    def row(self, label: str, *entries: Entry) -> None:
        """Add buttons side by side."""
        group = self.gui.add_button_group(label, [name for name, *_ in entries])
        actions = {name: action for name, _, _, action in entries}
        group.on_click(lambda _: self._run(actions[group.value]))
        for name, key, modifier, action in entries:
            self.by_name[f"{label}: {name}"] = group
            self.command(f"{label}: {name}", key, modifier, action)

    def arrows(self, label: str, keys: str, move: Callable[[float, float], object]) -> None:
        """Add buttons along x and y of the world, with keys in this order, or none."""
        ways = (("+x", 1, 0), ("-x", -1, 0), ("+y", 0, 1), ("-y", 0, -1))
        self.row(
            f"{label} ({' '.join(keys)})" if keys else label,
            *(
                (name, keys[i] if keys else None, None, lambda x=x, y=y: move(x, y))
                for i, (name, x, y) in enumerate(ways)
            ),
        )

    def button(
        self,
        label: str,
        action: Callable[[], object],
        key: str | None = None,
        modifier: str | None = None,
        color: str | None = None,
    ) -> None:
        """Add a button."""
        button = self.gui.add_button(label, color=color)
        button.on_click(lambda _: self._run(action))
        self.by_name[label] = button
        self.command(label, key, modifier, action)

    def command(
        self, label: str, key: str | None, modifier: str | None, action: Callable[[], object]
    ) -> None:
        """Add a command, with a key or without one."""
        command = self.gui.add_command(label, hotkey=key, modifier=modifier)
        command.on_trigger(lambda _: self._run(action))
        self.by_name[f"key {label}"] = command

    def on_change(self, field: Any, action: Callable[[], object]) -> None:
        """Do something when somebody changes a field."""
        # A field that the page itself sets has no client; it only follows the state.
        field.on_update(lambda event: self._run(action) if event.client_id is not None else None)


def keep(field: Any, value: object) -> None:
    """Bring a field to a value."""
    if field.value != value:
        field.value = value
