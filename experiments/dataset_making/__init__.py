"""How fast data sets are made, by whom, and what happens to them when workers are killed."""
