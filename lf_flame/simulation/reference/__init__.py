"""What the integrators are held against: forward tracing and closed forms."""
