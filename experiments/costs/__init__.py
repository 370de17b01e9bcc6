"""What accuracy costs in time: rendering, refocusing, latency."""
