"""What a network knows of depth: the depth permutation test."""
