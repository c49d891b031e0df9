"""Many trials: an order, worker processes, a journal, and what happens when something breaks.

Nothing is imported here: a worker needs two of these modules and waits for every one of them.
"""
