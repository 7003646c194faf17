"""``mavnav warmup``: compile the kernels in advance instead of at the first run."""

from __future__ import annotations

from mavnav.commands.terminal import emit

EPILOG = (
    "The result is kept in MAVNAV_CACHE_DIR, by default in the user's cache directory; later runs load it from there."
)


def warmup() -> None:
    """Compile all kernels into the disk cache, on all cores: once after installation."""
    from importlib import import_module
    from pathlib import Path
    from time import perf_counter

    import mavnav.kernels
    from mavnav.commands.progress import reporting
    from mavnav.kernels.building import prepare

    started_s = perf_counter()
    folder = Path(mavnav.kernels.__path__[0])
    names = sorted(".".join(path.relative_to(folder).with_suffix("").parts) for path in folder.rglob("*.py"))
    for name in names:
        import_module(f"mavnav.kernels.{name}")
    with reporting(quiet=False) as report:
        prepare(report)
    emit(f"{len(names)} files of kernels are ready, in {perf_counter() - started_s:.1f} s")
