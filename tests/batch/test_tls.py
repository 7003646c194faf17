"""A scheduler at tls://: Dask's own settings name the certificates, and without them nobody gets in."""

from __future__ import annotations

import gc
import shutil
import subprocess
from pathlib import Path

import pytest

from mavnav.errors import UsageError
from mavnav.jobs import dask as cluster_client
from mavnav.jobs.dask import connect
from mavnav.jobs.worker import Ended, Event, Job
from support import strange_jobs

distributed = pytest.importorskip("distributed", reason="the extra mavnav[cluster]")
dask = pytest.importorskip("dask", reason="the extra mavnav[cluster]")


@pytest.fixture
def certificate(tmp_path: Path) -> tuple[str, str]:
    """Return a key and a certificate that signs itself."""
    if not shutil.which("openssl"):
        pytest.skip("no openssl")
    key, certificate = str(tmp_path / "me.key"), str(tmp_path / "me.pem")
    options = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2", "-subj", "/CN=me"]
    subprocess.run(
        ["openssl", "req", "-x509", *options, "-keyout", key, "-out", certificate], check=True, capture_output=True
    )
    return key, certificate


def test_an_encrypted_cluster(certificate: tuple[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    key, public = certificate
    monkeypatch.setattr(cluster_client, "CONNECT_S", 2.0)
    roles = {f"tls_{role}_{part}": path for role in ("scheduler", "worker", "client") for part, path in
             (("key", key), ("cert", public))}  # fmt: skip
    security = distributed.Security(tls_ca_file=public, require_encryption=True, **roles)
    with distributed.LocalCluster(
        n_workers=1, processes=False, dashboard_address=":0", protocol="tls://", security=security
    ) as local:
        address = local.scheduler_address
        assert address.startswith("tls://")
        with (
            pytest.raises(UsageError, match="no scheduler with workers answers"),
            connect(address, tmp_path, 1, None, 1),
        ):
            pass
        gc.collect()  # the client that failed: its finalizer waits for a lock that the next one takes
        names = {"ca-file": public, "client.key": key, "client.cert": public}
        with (
            dask.config.set({f"distributed.comm.tls.{name}": value for name, value in names.items()}),
            connect(address, tmp_path, 1, None, 1) as cluster,
        ):
            events: list[Event] = []
            cluster.run_jobs([Job("square", strange_jobs.square, (7,))], events.append)
            assert [event.outcome.value for event in events if isinstance(event, Ended)] == [49]
