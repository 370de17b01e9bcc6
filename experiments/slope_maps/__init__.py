"""How good slope maps are, and simpler ones: on scenes whose geometry tells the slopes."""
