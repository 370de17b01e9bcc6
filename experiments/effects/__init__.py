"""Every effect of the simulator in absolute terms, beside a reference tracer."""
