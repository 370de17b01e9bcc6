"""Refocusing systems that can be run side by side: a light field in, refocused images out."""

import os

# Views are aligned by Numba's threads, then a network runs in its backend's. Those of Numba would
# stay awake for some milliseconds, as is the default, and hold the cores that the network needs.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
