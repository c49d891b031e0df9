"""Where the files of a published scene are, and which paths its XML may name."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from nw_eval.errors import SceneError
from nw_eval.files.inside import OutsideError, inside, what_is
from nw_eval.scenes.neverwhere.xml_file import Element
from nw_eval.words import ROBOTS, Robot


@dataclass(frozen=True, kw_only=True)
class Places:
    """The folders of one scene.

    Attributes:
        xml: the scene's XML.
        folder: the scene folder, which holds `geometry` and `3dgs`.
        name: of the scene, as the published table spells it.
    """

    xml: Path
    folder: Path
    name: str

    def resolve(self, element: Element, attribute: str, *, within: str = "") -> Path:
        """Return the existing file that an attribute names.

        Meshes are named relative to the folder of the XML, as `real_scenes/<scene>/...`; included
        files may name theirs relative to themselves. Within the scene folder alone, without the
        code repository round it, the leading `real_scenes/<scene>` falls away.

        Args:
            element: that names a file.
            attribute: in which it does.
            within: folder that the compiler section puts before it.

        Raises:
            SceneError: the path leaves the folder that it starts from, also by a link, or there is
                no such file.
        """
        text = element.get(attribute) or ""
        name = "/".join(part.replace("\\", "/") for part in (within, text) if part)
        candidates = [(self.xml.parent, name), (element.file.parent, name)]
        parts = PurePosixPath(name).parts
        if len(parts) > 2 and parts[0] == "real_scenes":
            candidates.append((self.folder, "/".join(parts[2:])))
        looked = ", ".join(dict.fromkeys(str(folder / below) for folder, below in candidates))
        missing = element.error(f"there is no file {text!r}", fix=f"looked at {looked}")
        for folder, below in candidates:
            try:
                path = inside(folder, below)
            except OutsideError as error:
                missing = element.error(
                    f"{attribute}={text!r}: {error}",
                    fix="no absolute path, no '..' and no link out of the scene is followed: copy "
                    "the file into it",
                )
            else:
                if what_is(path) == "file":
                    return path
        raise missing


def find_places(reference: Path, robot: Robot = "go1") -> Places:
    """Return the places of a scene.

    Args:
        reference: the scene folder, with the XML in it or two folders up (beside `real_scenes`), or
            the XML itself.
        robot: whose XML to take if there is one for each.

    Raises:
        SceneError: no XML is found.
    """
    if reference.suffix == ".xml":
        if what_is(reference) != "file":
            raise SceneError(f"{reference}: there is no such file")
        name = re.sub(r"^nw-go[12]-", "", reference.stem)
        beside = reference.parent / "real_scenes" / name
        folder = beside if what_is(beside) == "folder" else reference.parent
        return Places(xml=reference, folder=folder, name=name)
    if what_is(reference) != "folder":
        raise SceneError(f"{reference}: there is no such folder", fix="give a scene folder")
    name = reference.resolve().name
    order = (robot, *(other for other in ROBOTS if other != robot))
    for base in (reference, reference.parent.parent, reference.absolute().parent.parent):
        for each in order:
            xml = base / f"nw-{each}-{name}.xml"
            if what_is(xml) == "file":
                return Places(xml=xml, folder=reference, name=name)
    found = sorted(reference.glob("*.xml"))
    for each in order:
        named = [xml for xml in found if xml.name.startswith(f"nw-{each}-")]
        if len(named) == 1:
            return Places(xml=named[0], folder=reference, name=named[0].stem[len("nw-go1-") :])
    named = [xml for xml in found if xml.stem == name]
    if named or len(found) == 1:
        return Places(xml=(named or found)[0], folder=reference, name=name)
    raise SceneError(
        f"{reference}: {len(found)} XML files and none is nw-{robot}-{name}.xml",
        fix="put the scene's XML there, or name the XML instead of the folder",
    )
