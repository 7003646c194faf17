"""The Python interface: what the commands do, as functions; ``import mavnav`` has them all."""
