"""Small helpers that all parts share: nothing here depends on optics or learning."""
