"""Students: policies that see images, taught by one that sees the ground (DAgger with ACT).

A round drives trajectories in the training scenes and then learns from all of them so far. Whoever
drives is a card that runs as in every evaluation; what the student saw on the way and what the
teacher would have done are the trajectory's data.
"""
