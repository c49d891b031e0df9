"""Lets tests import the bundles of `adapters`, which a process with a mask runs, too."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
