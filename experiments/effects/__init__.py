"""Every effect of the simulator in absolute terms, compared with a reference tracer."""
