"""Pictures of the viewer for the documentation, taken in a real browser."""
