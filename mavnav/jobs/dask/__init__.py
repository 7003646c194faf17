"""Jobs on a Dask cluster: the scheduler assigns them, and reassigns the jobs of a lost worker.

Needs ``mavnav[cluster]``. Workers need the same version of mavnav, and the same folders under the same paths. A worker
runs one job at a time, in its own process. Dask runs a job that killed its worker on another one, a few times at most.
"""

from mavnav.jobs.dask.client import LOCAL, Cluster, connect

__all__ = ["LOCAL", "Cluster", "connect"]
