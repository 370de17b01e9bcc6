"""Parts of `tests/campaign.py`: what is done to the commands, and how it is judged."""

import sys
from pathlib import Path

# The programs of this checkout, and not those of an installation.
sys.path.insert(0, str(Path(__file__).parents[2]))
