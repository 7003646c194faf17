"""``mavnav warmup``: compile the kernels now rather than at the first run."""

from __future__ import annotations

from mavnav.commands.terminal import emit

EPILOG = "The result is kept beside the package, or in NUMBA_CACHE_DIR; later runs load it in a few tenths of a second."


def warmup() -> None:
    """Compile all kernels into the disk cache: about a minute after installation, nothing afterwards."""
    from importlib import import_module
    from pathlib import Path
    from time import perf_counter

    import mavnav.kernels

    started_s = perf_counter()
    folder = Path(mavnav.kernels.__path__[0])
    names = sorted(".".join(path.relative_to(folder).with_suffix("").parts) for path in folder.rglob("*.py"))
    for name in names:
        import_module(f"mavnav.kernels.{name}")
    emit(f"{len(names)} files of kernels are ready, in {perf_counter() - started_s:.1f} s")
