"""Studies: students of several kinds, trained and evaluated; results as figure and table.

A study is a list of students and of the scenes in which each is evaluated. Students are trained by
`learn.student` and evaluated by `api.run`; what is done already is kept.
"""
