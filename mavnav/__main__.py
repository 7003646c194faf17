"""``python -m mavnav``, and where the command begins and ends."""

import signal

# Ctrl-C while the modules are loaded ends the process without a word, not with a traceback.
signal.signal(signal.SIGINT, signal.SIG_DFL)

import atexit  # noqa: E402
import gc  # noqa: E402
import os  # noqa: E402
import sys  # noqa: E402
from contextlib import suppress  # noqa: E402
from typing import NoReturn  # noqa: E402

gc.set_threshold(20_000, 20, 20)  # what is loaded stays: looking through it for garbage takes 10 ms
os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # looking for some in all that is installed takes as long
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # no product here is worth threads, which take 0.1 s to begin

from mavnav import cli  # noqa: E402


def main() -> NoReturn:
    """Run the command line, and end at once: taking apart what was loaded, piece by piece, takes 50 ms."""
    try:
        cli.main()
    except SystemExit as ended:
        atexit._run_exitfuncs()  # noqa: SLF001
        with suppress(OSError, ValueError):  # it is full or closed
            sys.stderr.flush()
        os._exit(int(ended.code or 0))


if __name__ == "__main__":
    main()
