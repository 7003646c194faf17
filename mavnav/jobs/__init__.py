"""Process pool: jobs run in worker processes, so that a crash, a hang or a lack of memory affects one job alone.

A job is a module-level function with its arguments; a worker process runs one job after another. If a worker dies
during a job, only this job is lost, and a new worker replaces it. Workers are forked on Linux and spawned elsewhere,
and end when their parent dies. Their output to stdout and stderr is discarded.
"""
