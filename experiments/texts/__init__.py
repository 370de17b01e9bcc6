"""Numbers of README and docs, filled in from the records that they come from."""
