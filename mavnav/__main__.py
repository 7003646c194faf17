"""Entry point of ``mavnav`` and of ``python -m mavnav``."""

import signal

# Ctrl-C while modules are loaded ends the process silently, without a traceback.
signal.signal(signal.SIGINT, signal.SIG_DFL)

import atexit  # noqa: E402
import ctypes  # noqa: E402
import gc  # noqa: E402
import os  # noqa: E402
import sys  # noqa: E402
from contextlib import suppress  # noqa: E402
from typing import NoReturn  # noqa: E402

gc.set_threshold(200_000, 20, 20)  # little here refers to itself: searching for cycles more often takes 20 ms
os.environ.setdefault("NUMPY_MADVISE_HUGEPAGE", "0")  # with pages of 2 MB a log of 5000 scans takes 50 MB more
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # no matrix product here needs threads, which take 0.1 s to start

from mavnav import cli  # noqa: E402
from mavnav.errors import ExitCode  # noqa: E402


def answer_exit() -> None:
    """Let a C library that ends the process, as OpenBLAS does without memory, end it as USAGE.

    Its own code would be 1, that of a gate that failed. It calls ``exit``, mavnav itself ``_exit``.
    """
    with suppress(AttributeError, OSError, TypeError):  # other systems
        library = ctypes.CDLL(None)
        library.__cxa_atexit(library._exit, ctypes.c_void_p(ExitCode.USAGE), None)  # noqa: SLF001  a C function


def main() -> NoReturn:
    """Run the command line, and exit without the interpreter's cleanup, which takes 50 ms."""
    answer_exit()
    try:
        cli.main()
    except SystemExit as ended:
        atexit._run_exitfuncs()  # noqa: SLF001
        with suppress(OSError, ValueError):  # stderr is full or closed
            sys.stderr.flush()
        os._exit(int(ended.code or 0))


if __name__ == "__main__":
    main()
