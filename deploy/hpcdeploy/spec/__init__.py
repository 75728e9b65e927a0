"""The cluster file, and what follows from it alone: names, places, networks."""
