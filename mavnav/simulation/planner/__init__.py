"""The potential-field planner of the paper, with its answers to local minima."""
