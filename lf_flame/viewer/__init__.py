"""Looking at light fields: a local page, a single file, a notebook, by the same scripts."""
