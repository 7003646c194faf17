"""Functions run in processes of their own: one that crashes, hangs or eats the memory takes no other along.

A job is a function by name with its arguments; a worker process runs one after another. A worker that ends in
mid-job, whatever ended it, costs that job alone: another worker takes its place. Workers are forked on Linux, spawned
elsewhere, and follow their parent when it dies. What they print goes nowhere.
"""

from mavnav.jobs.pool import run_jobs, usable_cores
from mavnav.jobs.records import Ended, Event, Fate, Job, Outcome, Progressed, Report, Retried, Started
from mavnav.jobs.retry import run_with_retries
from mavnav.jobs.worker import attempt, failed

__all__ = [
    "Ended",
    "Event",
    "Fate",
    "Job",
    "Outcome",
    "Progressed",
    "Report",
    "Retried",
    "Started",
    "attempt",
    "failed",
    "run_jobs",
    "run_with_retries",
    "usable_cores",
]
