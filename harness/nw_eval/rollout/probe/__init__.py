"""One second of a policy, looked at closely: is the card what the checkpoint was trained with?

parts       which numbers of an observation come from which term
recording   what happened in that second
findings    what is wrong with it, in words
following   whether the policy does what it is commanded
hypotheses  what else the card might have meant
joint_signs other signs and scales of joints
search      which of these mends it
written     a change of a card as the lines to write
report      the table that `nw-eval policies check` prints
summary     what `nw-eval policies show` prints
"""
