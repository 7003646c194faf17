"""Writing logs: recordings of a simulation, and conversion to MCAP."""
