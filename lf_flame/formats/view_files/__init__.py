"""Light fields as one picture for each view: folders, mosaics, and their order."""
