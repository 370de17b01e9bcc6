"""What accuracy costs in time: rendering and refocusing."""
