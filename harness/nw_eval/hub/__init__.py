"""Places and policies from elsewhere: fetched from a Hugging Face hub once, and kept.

What is fetched is a stranger's: names and sizes are checked before a byte is asked for, what comes
is compared with the digest that the hub says, nothing of it is run. Afterwards no network is
needed, and a run's provenance says which revision it had.
"""
