"""One file a subcommand: options -> rooms -> print.

These modules are imported to print ``mavnav --help``, so at their top they import the standard library, typer and
``mavnav.errors``; rooms and other libraries are imported inside the functions.
"""
