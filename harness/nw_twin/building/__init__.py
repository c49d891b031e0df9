"""All stages of a twin, one after another, each only where its result is not there already.

build.py       the stages, as the verbs call them
folder.py      the result of each stage, and whether it is still valid
appearance.py  the stage that trains the splat
unlike.py      where a mesh is not as photographs show it
ablation.py    what mesh and depths are worth to the splat
"""
