"""Training of policies: a wing above runs and gates, of which nothing below knows.

The modules beside this one are what every training program shares. `teacher` and `student` are the
programs; `studies` trains and compares students.
"""
