"""Labelling a scene folder: where the scene lies, what is kept of it, and the robot's course.

labelling.py  the model, which needs no browser; page/ shows it in one
state.py      what one state decides
ground.py     heights along a course, and what legs make of them
files.py      scene folders read and written; and copied; published.py as Neverwhere has them
"""
