"""Everything that is wrong with a suite, its scenes and its policy, found in one go."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from nw_eval.clean import clean
from nw_eval.errors import NwEvalError, Problem, SuiteError

if TYPE_CHECKING:
    from nw_eval.catalogue import FoundScene
    from nw_eval.policies import Bundle
    from nw_eval.request import Request
    from nw_eval.scenes.finding import SceneFinding
    from nw_eval.suite import Draft
    from nw_eval.words import Collision


class Faults:
    """What is wrong with a suite: the file's own faults first found, then whatever is added."""

    def __init__(self, draft: Draft) -> None:
        self._draft = draft
        self._problems = list(draft.problems)
        self._others: list[NwEvalError] = []

    def at(self, location: tuple[str | int, ...], error: NwEvalError) -> None:
        """Add what is wrong with something that the suite names there: a problem for each line."""
        for line in str(error).splitlines():
            self._problems.append(self._draft.source.problem(location, line, None))

    def add(self, error: NwEvalError) -> None:
        """Add what is wrong elsewhere."""
        self._others.append(error)

    def extend(self, problems: list[Problem]) -> None:
        """Add problems of the suite's file."""
        self._problems += problems

    def raise_any(self) -> None:
        """Raise what was found, if anything was: faults elsewhere alone as what they are.

        Raises:
            SuiteError: faults of the suite, and any other beside them.
            NwEvalError: the only fault, which is not the suite's.
        """
        if not self._problems and len(self._others) == 1:
            raise self._others[0]
        if self._problems or self._others:
            ordered = sorted(self._problems, key=lambda problem: (problem.line, problem.column))
            raise SuiteError(ordered, self._others)


def open_scenes(
    draft: Draft, faults: Faults, collision: Collision | None
) -> tuple[FoundScene, ...]:
    """Return the scenes that a suite names, each once, as far as they can be opened.

    Args:
        draft: the suite.
        faults: where to tell what is wrong.
        collision: how meshes collide, whatever the suite says of it.
    """
    from nw_eval import catalogue
    from nw_eval.errors import SceneError
    from nw_eval.suite import tier_problems
    from nw_eval.survey.trail import start_finding

    found: dict[tuple[str, Collision], FoundScene] = {}
    failed: list[str] = []
    for index, pattern in draft.scenes.items():
        try:
            for each in catalogue.references([pattern], draft.base, collision=collision):
                if each not in found:
                    place = found[each] = catalogue.FoundScene.at(*each)
                    if free := start_finding(place.scene):
                        faults.at(("scenes", index), _refused(place.scene.name, free))
        except SceneError as error:
            faults.at(("scenes", index), error)
            failed.append(pattern)
        except OSError as error:  # No file system takes such a name.
            message = f"no scene matches {clean(pattern, at_most=60)!r}: {error.strerror}"
            faults.at(("scenes", index), SceneError(message, fix="name a scene or its folder"))
            failed.append(pattern)
    # A tier of a scene that exists, and is not run for another fault's sake, is no fault.
    meant = [place.scene.name for place in found.values()]
    faults.extend(tier_problems(draft, meant + list(catalogue.names() if failed else ()), failed))
    return tuple(found.values())


def _refused(scene: str, finding: SceneFinding) -> NwEvalError:
    from nw_eval.errors import SceneError

    return SceneError(f"scene {clean(scene, at_most=100)}: {finding.message}", fix=finding.fix)


def open_policy(
    draft: Draft, faults: Faults, request: Request, *, card: Path | None, may_fail: bool
) -> Bundle | None:
    """Return the policy of a request or else of the suite, checked; None if it cannot be used.

    Args:
        draft: the suite.
        faults: where to tell what is wrong.
        request: what is asked for in place of the suite's own.
        card: where the policy lies, if that is known.
        may_fail: as for `vet_bundle`.
    """
    from nw_eval.errors import PolicyError
    from nw_eval.policies import find_card, load_bundle

    own = draft.text("policy")
    named = request.policy if card is None else str(card)
    if named is None and own is None:
        return None  # The file's own fault says so.
    try:
        path = find_card(_from_base(draft.base, own or "") if named is None else named)
    except PolicyError as error:
        if named is None:
            faults.at(("policy",), error)
        else:
            faults.add(error)
        return None
    try:
        bundle = load_bundle(path, checkpoint=request.checkpoint)
    except NwEvalError as error:
        faults.add(error)
        return None
    return vet_policy(draft, faults, request, bundle, may_fail=may_fail)


def is_own_policy(draft: Draft, request: Request) -> bool:
    """Return whether the policy of a request is the suite's own, also by another path to its card.

    With other weights for its card (`checkpoint`) it is a candidate in the place of the suite's
    own, and counts as that.

    Args:
        draft: the suite.
        request: what is asked for.
    """
    from nw_eval.errors import PolicyError
    from nw_eval.policies import find_card

    own, named = draft.text("policy"), request.policy
    if named is None:
        return True
    if own is None or any(each.startswith("hub:") for each in (own, named)):
        return named == own
    try:
        return find_card(named).samefile(find_card(_from_base(draft.base, own)))
    except (PolicyError, OSError):
        return False


def vet_policy(
    draft: Draft, faults: Faults, request: Request, bundle: Bundle, *, may_fail: bool
) -> Bundle | None:
    """Return a policy that is loaded already, checked; None if it cannot be used.

    Args:
        draft: the suite.
        faults: where to tell what is wrong.
        request: what is asked for in place of the suite's own.
        bundle: the policy.
        may_fail: as for `vet_bundle`.
    """
    from nw_eval.protocol import PROTOCOLS, STRICT
    from nw_eval.rollout.confined.vetting import vet_bundle
    from nw_eval.words import Robot

    try:
        robot = _known(draft.text("robot"), Robot) if request.robot is None else request.robot
        return vet_bundle(
            bundle,
            robot or bundle.card.robot,
            protocol=PROTOCOLS.get(draft.text("protocol") or "", STRICT),
            allow_code=request.allow_code,
            may_fail=may_fail,
        )
    except NwEvalError as error:
        faults.add(error)
        return None


def _known(word: str | None, words: Any) -> str | None:
    """Return a word of the suite's if it is a valid one; its own fault is told already."""
    return word if word in get_args(words) else None


def _from_base(base: Path, policy: str) -> str:
    """Return what names a suite's own policy: its relative path starts from the suite's folder."""
    own = base / policy
    return str(own) if ("/" in policy or own.suffix == ".yaml") and own.exists() else policy
