"""Accuracy against time: rendering and refocusing."""
