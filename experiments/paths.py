"""Where the experiments' own files lie."""

from pathlib import Path

EXPERIMENTS = Path(__file__).parent
PAPER_VALUES = EXPERIMENTS / "paper_values.toml"
"""The numbers that the paper prints."""

DATA_SETS = tuple(EXPERIMENTS.parent / "data_gen" / f"{kind}.toml" for kind in ("shapes", "flames"))
"""Configurations of the paper's two data sets."""

REFERENCE = EXPERIMENTS / "results"
"""Reference results: committed, shown beside a user's own, never written by his runs."""
