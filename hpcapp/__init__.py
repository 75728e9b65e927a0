"""The user's side: the command, the communicator and the master processes of applications."""
