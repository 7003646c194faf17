"""One file a subcommand: options -> pipelines -> messages.

These modules are imported to print ``mavnav --help``, so at their top they import the standard library, typer,
``mavnav.errors`` and ``mavnav.units``; other packages and libraries are imported inside the functions.
"""
