"""``mavnav warmup``: compile the kernels now rather than at the first run."""

from __future__ import annotations

from mavnav.commands.terminal import emit

EPILOG = "The result is kept beside the package, or in NUMBA_CACHE_DIR; later runs load it in a few tenths of a second."


def warmup() -> None:
    """Compile all kernels into the disk cache: about a minute after installation, nothing afterwards."""
    from importlib import import_module
    from pkgutil import iter_modules
    from time import perf_counter

    import mavnav.kernels

    started_s = perf_counter()
    names = sorted(module.name for module in iter_modules(mavnav.kernels.__path__))
    for name in names:
        import_module(f"mavnav.kernels.{name}")
    emit(f"{len(names)} files of kernels are ready, in {perf_counter() - started_s:.1f} s")
