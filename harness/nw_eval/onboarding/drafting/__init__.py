"""A first card for a checkpoint, from what it says of itself.

`write_card_draft` writes a card whose comments say what is known, what is a guess, and what its
author must check.
"""

from nw_eval.onboarding.drafting.draft import write_card_draft

__all__ = ["write_card_draft"]
