"""The strict configuration: models and defaults, YAML with line numbers, and how the layers are merged."""
