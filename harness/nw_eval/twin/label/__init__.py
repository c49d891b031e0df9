"""Labelling a scene folder: where the place lies, what is kept of it, and the robot's course.

labelling.py  the model, which needs no browser; page/ shows it in one
edits.py      the place, and the line of states
state.py      what one state decides
ground.py     heights along a course; hints.py what legs make of them
opening.py    scene folders read; copying.py, saving.py and published.py written
"""
