"""Learning: programs that make policies. A wing above runs and gates; nothing below knows it."""
