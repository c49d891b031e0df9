"""A policy looked at closely for some seconds: is its card what the checkpoint was trained with?

parts           which numbers of an observation come from which term
recording       what happened in a second or two under one card
findings        what is wrong with it, in words
following       whether the policy does what it is commanded
hypotheses      what else the card might have meant
joint_signs     other signs and scales of joints
other_terms     other scales, signs and places of terms
other_controls  other motors, poses and rates
motors          the motors of a card
search          which of these helps most
comparison      the policy under its card and under others
budget          how long commands and other cards are tried
written         a change of a card as the lines to write
rows            what a check showed, as plain values
report          the check itself: runs a policy, and fills the rows
summary         what a card says, as plain values
"""
