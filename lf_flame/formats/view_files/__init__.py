"""Light fields as one picture for each view: folders, archives, lists, mosaics, and their order."""
