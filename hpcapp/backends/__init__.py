"""Where tasks run: every backend is an Executor."""
