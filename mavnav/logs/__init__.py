"""Logs: from a file of any of the usual formats to clean scans, and to an account of everything odd about it.

``survey`` reads a log once and reports what is there; ``open_log`` also chooses what to use; ``Log.scans`` streams it.
"""

from mavnav.logs.content import check_log, content_sha256
from mavnav.logs.log import Log
from mavnav.logs.opening import choose, open_log
from mavnav.logs.records import Damage, Odometry, ScanCounts, Topic
from mavnav.logs.survey import Survey, motion_and_scan_topics, survey

__all__ = ["Damage", "Log", "Odometry", "ScanCounts", "Survey", "Topic"]
__all__ += ["check_log", "choose", "content_sha256", "motion_and_scan_topics", "open_log", "survey"]
