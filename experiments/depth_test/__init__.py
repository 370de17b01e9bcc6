"""Depth permutation test: whether a network knows depths or has memorised them."""
