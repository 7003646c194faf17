"""One file a subcommand: options -> rooms -> print.

These modules are imported to print ``mavnav --help``, so at their top they import the standard library, typer,
``mavnav.errors`` and ``mavnav.units``; rooms and other libraries are imported inside the functions.
"""
