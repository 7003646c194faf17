"""Closed-loop simulation: the world and its laser, the planner, and the mission that joins them with SLAM."""
