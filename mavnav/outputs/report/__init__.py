"""report.html: one run, or a comparison of several runs, on one self-contained page.

The page is generated only from finished run directories and the comparison's document, so that it can be regenerated
at any time. The same files give the same bytes.
"""
