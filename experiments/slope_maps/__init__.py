"""How good slope maps are: scenes of opaque layers, whose slopes their geometry tells, and rivals."""
