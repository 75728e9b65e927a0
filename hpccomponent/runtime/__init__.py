"""The I/O around the session: component and worker processes, and the task registry."""
