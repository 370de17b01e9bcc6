"""Effect planning: which optical effects of a scene are simulated, and how finely."""
