"""``python -m mavnav``, and where the command begins."""

import signal

# Ctrl-C while the modules are loaded ends the process without a word, not with a traceback.
signal.signal(signal.SIGINT, signal.SIG_DFL)

from mavnav.cli import main  # noqa: E402

if __name__ == "__main__":
    main()
