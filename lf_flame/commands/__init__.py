"""The program lf-flame."""
