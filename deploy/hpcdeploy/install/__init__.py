"""What is put on a machine: wheels, the environment, the loader as a service."""
