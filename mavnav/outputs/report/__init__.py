"""report.html: one run, or many runs set side by side, on one page that needs nothing else.

The page is drawn from finished run directories and the comparison's document, never from the program's memory, so
that it can be made again at any time and shows nothing that the files do not hold. The same files give the same bytes.
"""

from mavnav.outputs.report.page import single, write_report

__all__ = ["single", "write_report"]
