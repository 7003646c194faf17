"""Calibration of laser and odometry from one log: mounting, time offset, wheel scales, with their uncertainties."""
