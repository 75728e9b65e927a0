"""Machines for tests: SSH servers in this process, on loopback addresses, with real commands."""
