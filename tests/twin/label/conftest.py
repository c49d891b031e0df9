"""Makes the helpers of this folder importable, and the fixture `label` known."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from label_person import label

__all__ = ["label"]
