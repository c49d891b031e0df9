"""Bundles: a card together with the file of weights that it describes."""

from __future__ import annotations

import hashlib
import json
import os
import re
import stat
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar, cast

from pydantic import ValidationError

from nw_base.errors import PolicyError, nearest
from nw_base.files.inside import OutsideError, inside, regular, what_is
from nw_base.files.shipped import available, shipped
from nw_base.plugins import SENSORS, WRAPPERS, identity_of, is_code, key_of
from nw_policies.cards.card import Card
from nw_policies.cards.joints import held_places
from nw_policies.cards.load import CARD_FILE, load_card
from nw_policies.cards.model import CardModel
from nw_policies.cards.motors import NetworkMotor
from nw_policies.cards.networks import Checkpoint
from nw_policies.cards.observations import PluginObservation
from nw_policies.cards.wrappers import PluginWrap
from nw_policies.computes import computed_digest
from nw_scenes.robots import get_robot

if TYPE_CHECKING:
    from nw_base.memory import Arrays
    from nw_policies.cards.feeding import InputSpec
    from nw_policies.executor import Program
    from nw_scenes.hub.reference import Fetched

SIZE_LIMIT = 2**30
"""Bytes. The largest policy of this field is some 100 MB."""

NOTHING = hashlib.sha256(b"").hexdigest()
"""The digest of a policy that has neither weights nor code, or whose server gives none."""

_NO_FILE = "card "
"""What the reference of a card without a file begins with."""

_WHEREABOUTS = frozenset({"url", "timeout", "connect_timeout"})
"""Options of remote policies that say where they run and how long to wait."""


_NO_MEANING = {"title", "licence", "trained_on", "trained_speeds", "checkpoint", "python"}
"""Keys of a card that change no action; what is installed counts for no policy's identity."""
Options = TypeVar("Options", bound=CardModel)
CODE_LIMIT = 2**26
"""Bytes of all Python files together: 64 MiB, more than any policy's code."""

SCOPE = "code outside the card's folder is not part of it"
"""What every text that shows the digest says beside it."""


class Weights(NamedTuple):
    """A file whose digest has been verified."""

    path: Path
    sha256: str


@dataclass(frozen=True, kw_only=True, eq=False)
class PlannedFile:
    """A file of weights as programs of nw-eval; compare `RecordedFile`."""

    inputs: tuple[InputSpec, ...]
    """What the file declares to take."""
    parts: tuple[tuple[int, Program], ...]
    first: Arrays


@dataclass(frozen=True, kw_only=True)
class Bundle:
    """A valid card and a checkpoint: the one whose digest the card says, if it says one."""

    card: Card
    card_path: Path | None
    """The card's file; None where the card came from none."""
    checkpoint: Path | None
    """The weights; None for a policy without any."""
    checkpoint_sha256: str
    """Hex digest of the weights; of the code, where there is code and no weights; what the server
    says, for a remote policy, and empty until it was asked; else `NOTHING`."""
    code_sha256: str = ""
    """`code_digest` of the card's folder, if the card imports code; else empty."""
    networks: Mapping[str, Weights] = field(default_factory=dict[str, Weights])
    """The files of the networks that feed the checkpoint, by name."""
    motion: Weights | None = None
    """The file of the motion that the policy tracks."""
    motors: tuple[Weights, ...] = ()
    """The files of its motors' networks, in the order of their groups."""
    network: str = ""
    """Which network of its card this is the bundle of; empty for the policy itself."""
    programs: Mapping[str, PlannedFile] = field(default_factory=dict)
    """Where nw-eval runs the networks, what their files were planned into, if that has been done:
    by the name of the network, the checkpoint's under an empty one."""
    operator: str = ""
    """What of the networks nw-eval does not run, where the card leaves the choice and that is why
    its `runtime` is `native`."""
    instance: object | None = None
    """The policy itself, where it is an object of this process (`instance_bundle`)."""

    @property
    def name(self) -> str:
        """The policy's name."""
        return self.card.name

    @property
    def folder(self) -> Path:
        """Where the card lies; the working directory for one without a file."""
        return Path() if self.card_path is None else self.card_path.parent

    @property
    def python(self) -> Path | None:
        """The interpreter that the card names for its code; None = this one."""
        return None if self.card.python is None else self.folder.absolute() / self.card.python

    @property
    def reference(self) -> str:
        """What `load_bundle` finds it by, from anywhere; a card without a file it does not find."""
        return f"{_NO_FILE}{self.name}" if self.card_path is None else str(self.card_path.resolve())

    @property
    def subject(self) -> str:
        """What an error calls it."""
        policy = f"policy {self.name!r}"
        return f"network `{self.network}` of {policy}" if self.network else policy

    @property
    def where(self) -> str:
        """Where an error says that a card is wrong."""
        place = f"card {self.name!r}" if self.card_path is None else str(self.card_path)
        return f"{place}: networks.{self.network}" if self.network else place

    @property
    def card_text(self) -> str:
        """The card as its file has it, comments included; as JSON, for one without a file."""
        if self.card_path is None:
            return self.card.model_dump_json(by_alias=True, exclude_defaults=True, indent=2)
        return self.card_path.read_text(encoding="utf-8", errors="replace")

    @property
    def files(self) -> tuple[Path, ...]:
        """All files of weights, of the motion and of motors."""
        own = () if self.checkpoint is None else (self.checkpoint,)
        motion = () if self.motion is None else (self.motion.path,)
        motors = (weights.path for weights in self.motors)
        return (*own, *(weights.path for weights in self.networks.values()), *motion, *motors)

    @property
    def checkpoint_digest(self) -> str:
        """Hex digest of all weights: `checkpoint_sha256`; with networks, of it and theirs."""
        if not self.networks:
            return self.checkpoint_sha256
        feeding = {name: weights.sha256 for name, weights in self.networks.items()}
        text = json.dumps([self.checkpoint_sha256, feeding], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def of_network(self, name: str) -> Bundle:
        """Return the bundle of one of the networks, as if it were the policy."""
        weights = self.networks[name]
        return replace(
            self,
            card=self.card.of_network(name),
            checkpoint=weights.path,
            checkpoint_sha256=weights.sha256,
            networks={},
            network=name,
        )

    def by_its_own_runtime(self, operator: str) -> Bundle:
        """Return the bundle with a card that says `native`, since nw-eval lacks an operator.

        Args:
            operator: of its networks; empty = return the bundle as it is.
        """
        if not operator:
            return self
        card = self.card.model_copy(update={"runtime": "native"})
        return self.with_changes(card=card, operator=operator)

    def with_changes(self, **changes: Any) -> Bundle:
        """Return the bundle with other fields; keep the robot that it has loaded.

        `dataclasses.replace` forgets `joints`, which a process that may not read the robot needs.
        """
        changed = replace(self, **changes)
        if "joints" in self.__dict__ and changed.card.robot == self.card.robot:
            changed.__dict__["joints"] = self.joints
        return changed

    @property
    def origin(self) -> str:
        """What the digests say, short and in words."""
        words: list[str] = []
        if self.instance is not None:
            known = f", {self.checkpoint_sha256[:16]}" if self.checkpoint_sha256 else ""
            return f"an object in the calling process{known}"
        if self.checkpoint_sha256 == NOTHING and self.card.adapter == "remote":
            words.append("the server gives no digest")
        elif self.card.adapter == "remote":
            words.append(f"served {self.checkpoint_sha256[:16]}")
        elif self.files:
            words.append(self.checkpoint_digest[:16])
        if self.code_sha256 == NOTHING:
            words.append("no code in the card's folder")
        elif self.code_sha256:
            words.append(f"code {self.code_sha256[:16]}")
        return ", ".join(words) or "no checkpoint"

    @property
    def digest(self) -> str:
        """Hex SHA-256 of all that can change an action: card, weights, code beside the card.

        So can a sensor or a wrapper of an installed package: its version and its code count, too.
        """
        fields = self._meaning()
        parts = [fields, self.checkpoint_digest]
        parts += [self.code_sha256] if self.code_sha256 else []
        parts += [{"plugins": self.plugins}] if self.plugins else []
        parts += [] if self.motion is None else [{"motion": self.motion.sha256}]
        parts += [{"motors": [each.sha256 for each in self.motors]}] if self.motors else []
        # Their order counts where a file takes its inputs in it. Other cards keep what they had.
        is_sorted = not self.networks
        if is_sorted and (orders := _orders(fields)):
            parts.append(orders)
        text = json.dumps(parts, sort_keys=is_sorted)
        return hashlib.sha256(text.encode()).hexdigest()

    @cached_property
    def computes(self) -> str:
        """Hex SHA-256 of the policy's computation; empty if it cannot be read from the files.

        It is the same for every export of one network on a card of the same meaning: it covers
        `computed_digest` of the files of weights, code beside the card, and the card without its
        name and title. A file that cannot be read so counts with its own digest.

        Raises:
            PolicyError: as `read_checkpoint`.
        """
        if self.card.adapter == "remote" and self.checkpoint_sha256 in {"", NOTHING}:
            return ""
        if self.instance is not None and not self.checkpoint_sha256:
            return ""
        fields = self._meaning()
        fields.pop("runtime", None)  # What runs a network changes no more than an export of it.
        del fields["name"]
        feeding = {name: _computed(self.of_network(name)) for name in self.networks}
        # Not sorted: one input takes the observations in their order.
        parts = [fields, _computed(self), feeding, self.code_sha256]
        parts += [] if self.motion is None else [self.motion.sha256]
        parts += [each.sha256 for each in self.motors]
        text = json.dumps([*parts, self.plugins] if self.plugins else parts)
        return hashlib.sha256(text.encode()).hexdigest()

    def _meaning(self) -> dict[str, Any]:
        """Return all of the card that can change an action, and its name."""
        fields = self.card.model_dump(mode="json", by_alias=True, exclude=_NO_MEANING)
        for network in fields["networks"].values():
            del network["checkpoint"]
        if not fields["networks"]:
            del fields["networks"]  # Cards have the digest that they had before there were any.
        if not fields["cameras"]:
            del fields["cameras"]  # As above.
        if fields["reference"] is None:
            del fields["reference"]  # As above.
        else:  # Its digest counts by itself, wherever the file lies.
            for key in ("file", "sha256", "source"):
                del fields["reference"][key]
        for group in fields["control"].get("motors", ()):  # As above.
            for key in ("file", "sha256", "source"):
                group.pop(key, None)
        if fields["runtime"] != "native" or self.operator:
            del fields["runtime"]  # As above; and whether nw-eval can run it follows from the rest.
        if self.card.adapter == "remote":
            # Where the same policy is served changes nothing; which one it is, `digest` says.
            options = fields["options"].items()
            fields["options"] = {key: value for key, value in options if key not in _WHEREABOUTS}
        return fields

    @cached_property
    def plugins(self) -> dict[str, str]:
        """Installed sensors and wrappers of the card: `sensors.NAME: package version sha256`."""
        plugins: dict[str, str] = {}
        for spec in self.card.observations.values():
            named = [(SENSORS, spec.sensor)] if isinstance(spec, PluginObservation) else []
            named += [(WRAPPERS, w.wrapper) for w in spec.wrap if isinstance(w, PluginWrap)]
            for group, name in named:
                if not is_code(name):
                    plugins[key_of(group, name)] = identity_of(group, name)
        return dict(sorted(plugins.items()))

    @cached_property
    def joints(self) -> int:
        """How many numbers an action has: one for each joint of the robot that is not held.

        A process that is sent the bundle is sent them, too, and need not find the robot.

        Raises:
            UsageError: there is no such robot.
        """
        joints = get_robot(self.card.robot).joints
        return len(joints) - len(held_places(self.card.control.held, joints))

    def read_checkpoint(self) -> bytes:
        """Return the bytes of the weights after comparing their digest with the checked one again.

        Raises:
            PolicyError: the file is gone, or has changed since the bundle was loaded.
        """
        if self.checkpoint is None:
            return b""
        own = Weights(self.checkpoint, self.checkpoint_sha256)
        return read_file(own, self.folder, "checkpoint")

    def read_motor(self, number: int) -> bytes:
        """Return the bytes of one of `motors`, as `read_checkpoint`."""
        return read_file(self.motors[number], self.folder, "network of motors")


def read_file(file: Weights, folder: Path, what: str) -> bytes:
    """Return the bytes of a file after comparing their digest with the one that was checked.

    Args:
        file: as it was measured.
        folder: of what names it, for errors.
        what: it is, for errors.

    Raises:
        PolicyError: it is gone, too large, or has changed since.
    """
    data = _read(file.path, folder, what=what, is_own=what == "checkpoint")
    if hashlib.sha256(data).hexdigest() != file.sha256:
        raise PolicyError(
            f"{file.path}: the {what} changed while it was in use",
            fix="start again once it is no longer written to",
        )
    return data


def _orders(fields: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return the names of a card whose order counts, where it is not that of the alphabet.

    One input takes the observations in their order. Of two patterns that mean one joint the value
    of the later one counts.
    """
    orders = {"observations": list(fields["observations"])}
    for name, value in fields["control"].items():
        if isinstance(value, dict):
            orders[name] = [
                key for key in cast("dict[str, Any]", value) if re.search(r"[*?[]", key)
            ]
    return {name: keys for name, keys in orders.items() if keys != sorted(keys)}


def _computed(bundle: Bundle) -> str:
    """Return the digest of what the weights of a bundle compute, or of their file."""
    if bundle.checkpoint is None or bundle.card.adapter.startswith("python:"):
        return bundle.checkpoint_sha256  # Code may read anything of a file, its metadata too.
    return computed_digest(bundle.read_checkpoint()) or bundle.checkpoint_sha256


def load_bundle(
    name_or_path: str | Path, *, search: Path | None = None, checkpoint: Path | None = None
) -> Bundle:
    """Find a bundle, read its card and verify its checkpoint and networks.

    Args:
        name_or_path: name of a shipped bundle or of one in the project's `policies/`, a folder
            with a `policy.yaml` (also relative to the shipped policies), a card, or
            `hub:org/name[@revision]`, which is fetched if it is not on this machine.
        search: the project folder, by default the working directory.
        checkpoint: weights to use in place of those of the card's `checkpoint`. They are the
            caller's choice: their digest is computed and recorded, not compared with the card's. So
            are those that a card names without a digest.

    Raises:
        PolicyError: there is no such bundle; the card has problems; a file of weights is missing,
            too large, outside the card's folder, or has another digest than the card says; the
            code beside the card is too large or cannot be read.
        FetchError, PrerequisiteError, StoreError: as `find_card`.
    """
    card_path = find_card(name_or_path, search=search)
    card = load_card(card_path)
    code = code_digest(card_path.parent) if _imports_code(card) else ""
    networks = {
        name: _verified(card_path, network.checkpoint, key=f"networks.{name}.checkpoint")
        for name, network in card.networks.items()
    }
    if card.checkpoint is None:
        if checkpoint is not None:
            raise PolicyError(
                f"{card_path}: policy {card.name!r} has no weights, but --checkpoint gives some",
                fix="drop --checkpoint",
            )
        weights = None
    elif checkpoint is None:
        weights = _verified(card_path, card.checkpoint)
    else:
        weights = _measured(checkpoint, card_path, card.checkpoint.source)
    motion = None
    if card.reference is not None and card.reference.file is not None:
        held = card.checkpoint is not None and card.reference.file == card.checkpoint.file
        # The checkpoint holds it: other weights have a motion of their own.
        motion = weights if held else _verified(card_path, card.reference, key="reference")
    motors = tuple(
        _verified(card_path, motor, key=f"control.motors.{number}")
        for number, motor in enumerate(card.control.motors or ())
        if isinstance(motor, NetworkMotor)
    )
    known = "" if card.adapter == "remote" else code or NOTHING
    return Bundle(
        card=card,
        card_path=card_path,
        checkpoint=None if weights is None else weights.path,
        checkpoint_sha256=known if weights is None else weights.sha256,
        code_sha256=code,
        networks=networks,
        motion=motion,
        motors=motors,
    )


def _verified(card_path: Path, named: Checkpoint, *, key: str = "checkpoint") -> Weights:
    """Return the file that a key of the card names, with the digest that the card says."""
    what = "motion" if key == "reference" else "checkpoint"
    what = "network of motors" if key.startswith("control.motors") else what
    path, is_own = _beside(card_path, named.file, what), key == "checkpoint"
    weights = _measured(path, card_path, named.source, what, is_own=is_own)
    if named.sha256 is not None and weights.sha256 != named.sha256:
        raise PolicyError(
            f"{weights.path}: the {what}'s SHA-256 is {weights.sha256}, that on the card is "
            f"{named.sha256}",
            fix=f"get the right file, or correct `{key}.sha256` if this one is meant",
        )
    return weights


def _measured(
    path: Path,
    card_path: Path,
    source: str | None,
    what: str = "checkpoint",
    *,
    is_own: bool = True,
) -> Weights:
    data = _read(path, card_path.parent, source, what, is_own=is_own)
    return Weights(path, hashlib.sha256(data).hexdigest())


def find_card(name_or_path: str | Path, *, search: Path | None = None) -> Path:
    """Return the path of a bundle's card.

    Args:
        name_or_path: as for `load_bundle`.
        search: as for `load_bundle`.

    Raises:
        PolicyError: there is no such bundle.
        FetchError: it is not on this machine, and its hub cannot be reached.
        PrerequisiteError: it is not on this machine, and the extra `hub` is not installed.
        StoreError: it cannot be kept.
    """
    if str(name_or_path).startswith("hub:"):
        from nw_scenes.hub.fetch import located
        from nw_scenes.hub.reference import parse

        return card_of_fetched(located(parse(str(name_or_path), "policy")))
    known = available("policies", search)
    if str(name_or_path) in known:
        return known[str(name_or_path)] / CARD_FILE
    path = Path(name_or_path)
    kind = what_is(path)
    packed = shipped("policies") / path / CARD_FILE
    if kind == "nothing" and what_is(packed) == "file":
        return packed  # For example `examples/playground-go1`.
    if kind == "folder":
        if what_is(path / CARD_FILE) != "file":
            raise PolicyError(
                f"{path}: the folder has no {CARD_FILE}", fix="write a card, or name another folder"
            )
        return path / CARD_FILE
    if kind == "file":
        if path.suffix not in {".yaml", ".yml"}:
            raise PolicyError(
                f"{path}: a policy is named by its card, not by its weights",
                fix="give a policy.yaml, and these weights with --checkpoint",
            )
        return path
    try:
        regular(path)
    except OSError as error:
        raise PolicyError(f"{path}: {error.strerror}", fix="name a card") from None
    is_path = "/" in str(name_or_path) or path.suffix in {".yaml", ".yml"}
    missing = (
        "there is no such folder or card" if is_path else "no policy, folder or card has that name"
    )
    raise PolicyError(
        f"unknown policy {str(name_or_path)!r}: {missing}",
        fix=nearest(str(path), known),
    )


def card_of_fetched(fetched: Fetched) -> Path:
    """Return the card of a fetched policy.

    Raises:
        PolicyError: it has none.
    """
    if what_is(fetched.folder / CARD_FILE) != "file":
        raise PolicyError(
            f"{fetched.reference}: its revision {fetched.revision[:12]} has no {CARD_FILE}",
            fix="name a repository with a card; weights alone need a card of your own",
        )
    return fetched.folder / CARD_FILE


def senses_by_code(card: Card) -> bool:
    """Whether sensors or wrappers are `module:Class`, which runs beside the world."""
    return any(
        is_code(spec.sensor) or any(is_code(wrap.wrapper) for wrap in spec.wrap)
        for spec in card.observations.values()
    )


def _imports_code(card: Card) -> bool:
    """Whether policy, sensors or wrappers are `module:Class`."""
    return card.adapter.startswith("python:") or senses_by_code(card)


def _beside(card_path: Path, file: str, what: str) -> Path:
    """Return the path of a file of a card, which may not leave its folder by a link either."""
    try:
        return inside(card_path.parent, file)
    except OutsideError as error:
        raise PolicyError(
            f"{card_path}: {what} {file!r} is outside the card's folder: {error}",
            fix="move the file into the card's folder"
            + "; only --checkpoint may name one elsewhere" * (what == "checkpoint"),
        ) from None


def _read(
    path: Path,
    folder: Path,
    source: str | None = None,
    what: str = "checkpoint",
    *,
    is_own: bool = True,
) -> bytes:
    try:
        facts = path.stat()
        if not stat.S_ISREG(facts.st_mode):  # A device or a pipe may never end.
            raise PolicyError(f"{path}: the {what} is not a file", fix="check the path")
        size = facts.st_size
        if size > SIZE_LIMIT:
            raise PolicyError(
                f"{path}: the {what} has {size / 2**20:.0f} MiB, over the limit of "
                f"{SIZE_LIMIT // 2**20}",
                fix="cut it into pieces"
                if what == "motion"
                else "export the actor alone, without optimiser state",
            )
        return path.read_bytes()
    except FileNotFoundError:
        origin = f" (from {source})" if source else ""
        raise PolicyError(
            f"{path}: the {what} is missing",
            fix=f"put it{origin} at {folder}" + (", or give --checkpoint FILE" * is_own)
            if path.is_relative_to(folder)
            else "check the path",
        ) from None
    except (OSError, ValueError) as error:  # A path with a zero byte is a ValueError.
        raise PolicyError(
            f"{path}: the {what} cannot be read: "
            f"{(isinstance(error, OSError) and error.strerror) or error}",
            fix="check the path",
        ) from None


class NoOptions(CardModel):
    """An adapter that has nothing to choose."""


def read_options(bundle: Bundle, model: type[Options]) -> Options:
    """Return the card's `options` as its adapter understands them.

    Raises:
        PolicyError: an unknown option, or a value that cannot be used; all of them at once.
    """
    try:
        return model.model_validate(dict(bundle.card.options))
    except ValidationError as error:
        problems: list[str] = []
        for problem in error.errors():
            name = ".".join(str(part) for part in problem["loc"])
            if problem["type"] == "extra_forbidden":
                problems.append(f"unknown option {name!r} ({nearest(name, model.model_fields)})")
            else:
                problems.append(f"option {name!r}: {problem['msg']}, not {problem['input']!r}")
        raise PolicyError(
            f"{bundle.where}: {'; '.join(problems)}",
            fix=f"correct `options` for the adapter `{bundle.card.adapter}`",
        ) from None


def was_instance(reference: str) -> bool:
    """Whether a bundle's `reference` is that of an object, which cannot be loaded."""
    return reference.startswith(_NO_FILE)


def instance_bundle(policy: object, card: Card, *, digest: str = "") -> Bundle:
    """Return the bundle of a policy that the caller has at hand.

    It runs only in this process (`engine.workers`), all trials with the same object,
    which is never closed. It must have `act(observation) -> 12 numbers`, or be a function that does
    that. Whatever else of `Policy` it has is used, as for a `python:` adapter: a trial depends on
    those before it unless `reset(seed)` forgets them, or there is nothing to forget.

    Args:
        policy: the object or function.
        card: what it sees and what its actions mean; its adapter is `python:module:Class`, for the
            record, and it names no files.
        digest: what tells this policy from others, such as the hex SHA-256 of its weights; empty if
            unknown, which its rows say.

    Raises:
        PolicyError: the card is of another kind of policy.
    """
    named = {"checkpoint": card.checkpoint is not None, "networks": bool(card.networks)}
    if not card.adapter.startswith("python:"):
        raise PolicyError(
            f"card {card.name!r}: adapter {card.adapter!r} opens files, the policy is an object",
            fix="write `python:module:Class`, where its class comes from",
        )
    for key, is_there in named.items():
        if is_there:
            raise PolicyError(
                f"card {card.name!r} names `{key}`, the policy is an object",
                fix=f"remove `{key}`",
            )
    return Bundle(
        card=card, card_path=None, checkpoint=None, checkpoint_sha256=digest, instance=policy
    )


def code_digest(folder: Path) -> str:
    """Return the hex SHA-256 of names and bytes of all `*.py` files below a folder, sorted.

    A link counts by where it points; what it points to counts only inside the folder.

    Raises:
        PolicyError: the files are too large together, or cannot be read.
    """
    root, total = folder.resolve(), 0
    digest = hashlib.sha256()
    try:
        for path in _python_files(root):
            target = os.fsencode(path.readlink()) if path.is_symlink() else b""
            data = b""
            if path.is_file() and path.resolve().is_relative_to(root):
                total += path.stat().st_size
                if total > CODE_LIMIT:
                    raise PolicyError(
                        f"{folder}: the Python files below the card are over "
                        f"{CODE_LIMIT // 2**20} MiB, and all count for the policy's identity",
                        fix="put the card and its code into a folder of their own",
                    )
                data = path.read_bytes()
            for part in (os.fsencode(path.relative_to(root).as_posix()), target, data):
                digest.update(len(part).to_bytes(8, "big") + part)
    except OSError as error:
        raise PolicyError(
            f"{error.filename}: the policy's code cannot be read: {error.strerror}",
            fix="make it readable: it counts for the policy's identity",
        ) from None
    return digest.hexdigest()


def _python_files(root: Path) -> list[Path]:
    """Return all files that end in `.py`, and all links to folders, which are not entered."""
    paths: list[Path] = []
    for folder, folders, files in os.walk(root, onerror=_raise):
        paths += [Path(folder, name) for name in files if name.endswith(".py")]
        paths += [path for name in folders if (path := Path(folder, name)).is_symlink()]
    return sorted(paths, key=lambda path: os.fsencode(path.relative_to(root).as_posix()))


def _raise(error: OSError) -> None:
    raise error
