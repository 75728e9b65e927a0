"""The wire: messages, their codec, the keys, and the worker session without I/O."""
