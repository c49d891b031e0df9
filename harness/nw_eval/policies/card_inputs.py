"""What feeds what on a card: every name that leads nowhere, every circle, each with its place."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from nw_eval.errors import Problem, nearest
from nw_eval.policies.card_networks import input_parts

if TYPE_CHECKING:
    from nw_eval.policies.card import Card
    from nw_eval.policies.card_networks import Inputs
    from nw_eval.yaml_file import Location, YamlFile

_NAME = re.compile(r"[A-Za-z_][\w-]{0,63}", re.ASCII)


def input_problems(card: Card, file: YamlFile) -> list[Problem]:
    """Return what is wrong with the inputs of the checkpoint and of its networks, in file order.

    Args:
        card: valid in itself.
        file: that it was read from.
    """
    if card.networks and card.adapter in {"zero", "remote"}:
        words = f"networks: adapter `{card.adapter}` has no checkpoint here that they could feed"
        fix = "remove them; a server has its networks on the card that it serves"
        return [file.problem(("networks",), words, None if card.adapter == "zero" else fix)]
    told = _Checked(card, file)
    told.look()
    return sorted(told.problems, key=lambda problem: (problem.line, problem.column))


def feeding_order(card: Card) -> list[str]:
    """Return the networks of a card, each behind those that feed it.

    Those of a circle are left out, and those that one feeds.
    """
    order: list[str] = []
    waiting = dict(card.networks)
    while ready := [name for name in waiting if _fed_by(card, name) <= set(order)]:
        order += ready
        for name in ready:
            del waiting[name]
    return order


class _Checked:
    """The problems of a card's inputs, as they are found."""

    def __init__(self, card: Card, file: YamlFile) -> None:
        self.problems: list[Problem] = []
        self._card = card
        self._file = file
        self._given = {
            name: network.given_as(name) for name, network in card.networks.items()
        }  # What each network gives.
        self._known = [
            *card.observations,
            *(part for all_ in self._given.values() for part in all_),
        ]

    def look(self) -> None:
        """Find all of them."""
        card = self._card
        used = self._inputs(("inputs",), card.inputs or {}, card.recurrent)
        for name, network in card.networks.items():
            place = ("networks", name)
            self._names(place, name)
            used |= self._inputs((*place, "inputs"), network.inputs, network.recurrent)
            if network.recurrent and network.adapter != "onnx":
                words = (
                    f"`recurrent` is for adapter onnx; `{network.adapter}` keeps its state itself"
                )
                self._tell((*place, "recurrent"), words, "remove it")
            if network.rate is not None and card.control.rate % network.rate:
                words = f"{network.rate} Hz, the policy acts at {card.control.rate} Hz"
                self._tell((*place, "rate"), words, "give a rate that divides it")
        if card.networks and card.inputs is None and not card.adapter.startswith("python:"):
            words = "`inputs` is missing: it says what the checkpoint itself takes"
            fix = f"for example `inputs: [{', '.join(self._known)}]`"
            self._tell(("networks",), words, fix, named=False)
        elif card.inputs is not None and used <= set(self._known):
            self._unused(used)  # What is not used is often what a misspelt name meant.
        self._circles()

    def _names(self, place: Location, name: str) -> None:
        network = self._card.networks[name]
        if name in self._card.observations:
            self._tell(place, "an observation is called that, too", "give it another name")
        for one, where in [
            (name, place),
            *((part, (*place, "outputs", part)) for part in network.outputs or ()),
        ]:
            if not _NAME.fullmatch(one):
                fix = "use letters, digits, '_' and '-', a letter first"
                self._tell(where, f"{one!r} is no name", fix)

    def _inputs(
        self, place: Location, inputs: Inputs, recurrent: dict[str, str] | None
    ) -> set[str]:
        """Check the inputs of one file; return all that they are made of."""
        used: set[str] = set()
        for name, parts in input_parts(inputs) if inputs else ():
            where = place if name is None else (*place, name)
            if name in (recurrent or {}):
                self._tell(where, f"{name!r} is in `recurrent` too", "name it in one of them")
            if not parts:
                self._tell(where, f"{name!r} has no observations", "name at least one")
            for index, part in enumerate(parts):
                used.add(part)
                if part not in self._known:
                    self._tell((*where, index), *self._unknown(part))
        return used

    def _unknown(self, part: str) -> tuple[str, str]:
        if part in self._given:
            words = f"network {part!r} gives {', '.join(self._given[part])}"
            return words, "name those that are meant"
        kind = "observation or network" if self._given else "observation"
        return f"unknown {kind} {part!r}", nearest(part, self._known)

    def _unused(self, used: set[str]) -> None:
        unused = [name for name in self._card.observations if name not in used]
        if unused:
            words = f"no input uses the observation {', '.join(unused)}"
            self._tell(("observations", unused[0]), words, "use it or remove it", named=False)
        for name, parts in self._given.items():
            idle = [part for part in parts if part not in used]
            if idle:
                words = f"no input uses {', '.join(idle)}"
                self._tell(("networks", name), words, "use it or remove it")

    def _circles(self) -> None:
        ordered = feeding_order(self._card)
        for name in self._card.networks:
            if name in ordered or (way := _way_back(self._card, name)) is None:
                continue
            words = f"it feeds itself: {' <- '.join(way)}"
            fix = "leave one of them out of `inputs`; a file keeps its own state"
            self._tell(("networks", name, "inputs"), words, fix)
            return  # The others of the circle would say the same.

    def _tell(self, place: Location, words: str, fix: str, *, named: bool = True) -> None:
        parts = [str(part) for part in place if isinstance(part, str)]
        shown = ".".join(parts[:3] if parts[0] == "networks" else parts[:1])
        said = f"{shown}: {words}" if named else words
        self.problems.append(self._file.problem(place, said, fix))


def _fed_by(card: Card, name: str) -> set[str]:
    """Return the networks that feed a network."""
    taken = {part for _, parts in input_parts(card.networks[name].inputs) for part in parts}
    return {
        other for other, network in card.networks.items() if taken & set(network.given_as(other))
    }


def _way_back(card: Card, name: str) -> list[str] | None:
    """Return the way from a network over those that feed it to itself; None = there is none."""
    ways = [[name]]
    seen: set[str] = set()
    for way in ways:
        for other in sorted(_fed_by(card, way[-1])):
            if other == name:
                return [*way, name]
            if other not in seen:
                seen.add(other)
                ways.append([*way, other])
    return None
