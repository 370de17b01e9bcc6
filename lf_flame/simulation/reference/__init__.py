"""References for the integrators: forward tracing and closed forms."""
