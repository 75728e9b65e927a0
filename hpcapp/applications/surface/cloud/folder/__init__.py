"""An arranged cloud in a folder."""
