"""The verbs of clusters (entry points ``hpc.commands``)."""
