"""The pipelines behind the commands: from an input file to a written run directory or document."""
