"""Which way is up: cameras are held level, floors are level, walls stand upright.

What each cue says is one quadratic form A, in units of its own uncertainty: a direction u is the
less likely the larger u' A u is. Forms add up, and their smallest eigenvector is what all of them
together take for up.

horizon.py     the cameras' sideways axes
planes.py      planes in the sparse points
consensus.py   which of them are level or upright; the cues together
floor.py       which level plane is the floor, and how high it lies
answer.py      all of it, in the order in which it is asked
"""
