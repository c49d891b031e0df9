"""One second of a policy, looked at closely: is the card what the checkpoint was trained with?

parts       which numbers of an observation come from which term
recording   what happened in that second
findings    what is wrong with it, in words
orders      the same second with other joint orders
report      the table that `nw-eval policies check` prints
summary     what `nw-eval policies show` prints
"""
