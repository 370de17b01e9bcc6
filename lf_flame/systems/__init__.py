"""Refocusing systems that can be run side by side: a light field in, refocused images out.

Views are aligned by Numba's threads, then a network runs in its backend's. Those of Numba stay
awake for some milliseconds by default and hold the cores that the network needs; where that
matters, start the process with ``OMP_WAIT_POLICY=PASSIVE`` in its environment, as the programs of
this package do for themselves.
"""
