"""The probability that a finished track is wrong although its scans were accepted (docs/method.md, "Doubt")."""
