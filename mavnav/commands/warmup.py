"""``mavnav warmup``: compile the kernels in advance instead of at the first run.

The result is kept in MAVNAV_CACHE_DIR, by default in the user's cache directory; later runs load it from there.
"""

from __future__ import annotations

from mavnav.commands.terminal import emit


def warmup() -> None:
    """Compile all kernels into the disk cache, on all cores: once after installation."""
    from importlib import import_module
    from pathlib import Path
    from time import perf_counter

    import mavnav.kernels
    from mavnav.commands.progress import reporting
    from mavnav.errors import OutputError
    from mavnav.kernels.machine.building import not_on_disk, prepare
    from mavnav.kernels.machine.cache import is_kept, user_directory
    from mavnav.kernels.machine.jit import KERNELS

    started_s = perf_counter()
    folder = Path(mavnav.kernels.__path__[0])
    names = sorted(".".join(path.relative_to(folder).with_suffix("").parts) for path in folder.rglob("*.py"))
    for name in names:
        import_module(f"mavnav.kernels.{name}")
    missing = len(not_on_disk())
    if missing and not is_kept():
        where = user_directory() or "the cache directory, which is no absolute path,"
        raise OutputError(f"{where} cannot be written; set MAVNAV_CACHE_DIR to a directory that can")
    with reporting(quiet=False) as report:
        prepare(report)
    left = len(not_on_disk())
    emit(f"compiled {missing - left} kernels in {perf_counter() - started_s:.1f} s; {len(KERNELS) - left} are ready")
