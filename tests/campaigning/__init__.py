"""A campaign against the commands: every case follows from the table of calls."""
