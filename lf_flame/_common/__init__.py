"""Small helpers that all parts share: nothing here knows of optics or learning."""
