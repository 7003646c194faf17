"""``python -m mavnav``."""

from mavnav.cli import main

if __name__ == "__main__":
    main()
