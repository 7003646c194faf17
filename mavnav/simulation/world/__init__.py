"""The world of a simulation: a scenario's walls and a laser that sees them; the planner does not know it."""
