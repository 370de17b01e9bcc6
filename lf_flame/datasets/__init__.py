"""Data sets of simulated light fields and their refocused images, on disk."""
