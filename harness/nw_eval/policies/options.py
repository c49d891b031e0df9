"""Options of an adapter: the part of a card that only one kind of checkpoint understands."""

from __future__ import annotations

from typing import TypeVar

from pydantic import ValidationError

from nw_eval.cards.model import CardModel
from nw_eval.errors import PolicyError, nearest
from nw_eval.policies.bundle import Bundle

Options = TypeVar("Options", bound=CardModel)


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
