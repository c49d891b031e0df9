"""XML that strangers wrote, read without obeying it.

No document type, no entities of its own, no external references: what could expand, or open other
files, is an error. Sizes and depths are limited, and every element knows its line.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from nw_eval.errors import SceneError
from nw_eval.files.inside import regular

_BYTES = 10_000_000
_DEPTH = 60
_ELEMENTS = 100_000
_ATTRIBUTES = 64  # of one element; MJCF's geom has 30


@dataclass(frozen=True, kw_only=True, eq=False)
class Element:
    """An element: its attributes as text, its children in order, and where it stands."""

    tag: str
    attributes: dict[str, str]
    file: Path
    line: int
    children: list[Element] = field(default_factory=list["Element"])

    def get(self, name: str, default: str | None = None) -> str | None:
        """Return an attribute."""
        return self.attributes.get(name, default)

    def all(self, tag: str) -> list[Element]:
        """Return the children of one tag."""
        return [child for child in self.children if child.tag == tag]

    def error(self, message: str, fix: str | None = None) -> SceneError:
        """Return an error that names file, line and element."""
        name = self.get("name")
        label = self.tag if name is None else f"{self.tag} {name!r}"
        return SceneError(f"{self.file}:{self.line}: {label}: {message}", fix=fix)


def read_xml(path: Path) -> Element:
    """Return the root element of a file.

    Raises:
        SceneError: the file cannot be read, is not well formed, too large or too deep, or has a
            document type or entities.
    """
    try:
        size = regular(path).stat().st_size
        if size > _BYTES:
            raise SceneError(f"{path}: {size} bytes", fix=f"a scene XML has less than {_BYTES}")
        text = path.read_bytes()
    except OSError as error:
        raise SceneError(f"{path}: cannot be read: {error.strerror or error}") from None
    return _TreeBuilder(path).read(text)


class _TreeBuilder:
    """Builds the tree of one file."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._open: list[Element] = []
        self._root: Element | None = None
        self._count = 0
        parser = expat.ParserCreate()
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.StartDoctypeDeclHandler = self._refuse_doctype
        parser.EntityDeclHandler = self._refuse_entity
        parser.ExternalEntityRefHandler = self._refuse_external
        self._parser = parser

    def read(self, text: bytes) -> Element:
        try:
            self._parser.Parse(text, True)
        except expat.ExpatError as error:
            raise SceneError(f"{self._path}:{error.lineno}: not well formed: {error}") from None
        except (ValueError, LookupError) as error:  # A character set that expat does not read.
            raise SceneError(f"{self._path}: not readable: {error}", fix="write UTF-8") from None
        if self._root is None:
            raise SceneError(f"{self._path}: no element in it")
        return self._root

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        line = self._parser.CurrentLineNumber
        self._count += 1
        if len(self._open) >= _DEPTH or self._count > _ELEMENTS:
            raise SceneError(
                f"{self._path}:{line}: {self._count} elements, {len(self._open)} deep",
                fix=f"at most {_ELEMENTS} elements, {_DEPTH} deep",
            )
        if len(attributes) > _ATTRIBUTES:
            raise SceneError(
                f"{self._path}:{line}: {len(attributes)} attributes", fix=f"at most {_ATTRIBUTES}"
            )
        element = Element(tag=tag, attributes=attributes, file=self._path, line=line)
        if self._open:
            self._open[-1].children.append(element)
        else:
            self._root = element
        self._open.append(element)

    def _end(self, _tag: str) -> None:
        self._open.pop()

    def _refuse_doctype(self, *_: object) -> None:
        raise self._refused("a document type")

    def _refuse_entity(self, *_: object) -> None:
        raise self._refused("an entity")

    def _refuse_external(self, *_: object) -> bool:
        raise self._refused("an external reference")

    def _refused(self, what: str) -> SceneError:
        line = self._parser.CurrentLineNumber
        return SceneError(f"{self._path}:{line}: {what} is not read here", fix="remove it")
