"""OpenMVS, where its programs are installed: they are called, nothing of them is in here."""

from nw_eval.twin.reconstruct.openmvs.programs import PROGRAMS, openmvs_mesh

__all__ = ["PROGRAMS", "openmvs_mesh"]
