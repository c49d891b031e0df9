"""What mesh and depths are worth to the splat of a place: its training, with and without them."""

from nw_eval.twin.ablation.ablate import ARMS, Arm, TrainedArm, ablate
from nw_eval.twin.ablation.table import table_text, write_table

__all__ = ["ARMS", "Arm", "TrainedArm", "ablate", "table_text", "write_table"]
