"""The communicator: an Executor whose workers are components reached over ZeroMQ."""
