"""The daemon on every machine that starts the worker build which fits it."""
