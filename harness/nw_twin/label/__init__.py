"""Labelling a scene folder: where the scene lies, what is kept of it, and the robot's course.

labelling.py   the model, which needs no browser
label_page.py  the page that shows it in one, by viser; its controls.py and drawing.py
state.py       one state: placement, crop and course
ground.py      heights along a course, and what legs make of them
files.py       scene folders copied, read and written; published.py as Neverwhere has them
"""
