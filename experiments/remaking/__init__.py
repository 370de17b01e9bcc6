"""Making the committed results again, by one command."""
