"""Machines whose first process is systemd."""
