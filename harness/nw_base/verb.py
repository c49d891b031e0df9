"""How a package declares verbs: a table in words, and what its options are called.

The entry-point group `nw_eval.verbs` names a `VerbTable` for each package that brings some.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from nw_base.errors import PluginError
from nw_base.plugins import imported, installed, subject, warn

GROUP = "nw_eval.verbs"


class Part(NamedTuple):
    """A verb of a family. The first line of its docstring is its help."""

    form: str
    """Its class, in `module`."""
    example: str
    """Arguments, without family and verb."""
    module: str


class Verb(NamedTuple):
    """A verb, or a family of them: `policies` has `policies list` and others."""

    form: str
    """Its class, in `module`; `-` of a family."""
    page: str
    """Of the docs."""
    line: str
    examples: list[str]
    """Arguments, without the verb."""
    parts: dict[str, Part]
    """Of a family."""
    module: str


@dataclass(frozen=True, kw_only=True)
class VerbTable:
    """The verbs that a package brings.

        Bring your own:
          twin - how-to/twins.md make a scene of photographs
            build BuildTwin photographs/ --out corridor
          scenes
            import ImportScan scan.glb --out my-hall

    A line without indent is a group. By two spaces stand a verb, its class (`-` of a family), a
    page of the docs and what it does; or a family of nw-eval's alone. By four stand an example
    after `$`, or a verb of the family: name, class, example.

    Attributes:
        table: those lines.
        module: the package whose modules have the classes, one for each verb, by its name.
        renamed_flags: old names of options, by verb.
        out_was_positional: verbs that took what `--out` names as their last argument.
        option_groups: titles under which help pages list options, by field.
    """

    table: str
    module: str
    renamed_flags: Mapping[str, dict[str, str]] = field(default_factory=dict)
    out_was_positional: frozenset[str] = frozenset()
    option_groups: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


def declared() -> Iterator[VerbTable]:
    """Yield the tables of installed packages; one that cannot be used is warned of."""
    for name, (point, *_) in installed(GROUP).items():
        try:
            value = imported(GROUP, name)
        except PluginError as error:
            warn(str(error))
            continue
        if isinstance(value, VerbTable):
            yield value
        else:
            warn(f"{subject(point)} is a {type(value).__name__}, no VerbTable")


def add_verbs(groups: dict[str, dict[str, Verb]], table: str, module: str) -> None:
    """Add the verbs of a table; what is there already stays.

    Args:
        groups: verbs by name, by the title of their group.
        table: as `VerbTable` has it.
        module: as there.
    """
    known = {name: verb for group in groups.values() for name, verb in group.items()}
    group, verb, home = dict[str, Verb](), Verb("", "", "", [], {}, ""), ""
    for line in table.strip().splitlines():
        depth, words = len(line) - len(line.lstrip()), line.strip()
        if depth == 0:
            group = groups.setdefault(words.rstrip(":"), {})
        elif depth == 2:
            name, *rest = words.split(" ", 3)
            home = f"{module}.{name}"
            if not rest:
                verb = known[name]
                continue
            form, page, told = rest
            verb = Verb(form, page, told, [], {}, home)
            group.setdefault(name, verb)
        elif words.startswith("$"):
            verb.examples.append(words[1:].strip())
        else:
            name, form, *example = words.split(" ", 2)
            verb.parts.setdefault(name, Part(form, " ".join(example), home))
