"""The same jobs on a Dask cluster: the scheduler hands them out, and gives those of a lost worker to another.

Needs ``mavnav[cluster]``. Workers have the same mavnav, and see the same folders under the same names. A worker runs
one job at a time, in itself: what it dies of, Dask tries on another, and gives up after some.
"""

from mavnav.jobs.dask.client import LOCAL, Cluster, connected

__all__ = ["LOCAL", "Cluster", "connected"]
