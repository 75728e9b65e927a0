"""Every task of surface reconstruction (entry points ``hpc.tasks``)."""
