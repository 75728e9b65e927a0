"""Jobs on a cluster: their folder on the head, and how they are watched."""
