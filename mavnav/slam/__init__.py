"""The SLAM engine: the tracker of the paper's Figure 1, the two methods, and the passes over a whole log."""
