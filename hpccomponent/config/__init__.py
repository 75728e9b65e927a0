"""A strict reader of YAML files: every mistake at once, each with its file, line and column."""
