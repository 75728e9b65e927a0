"""Applications of the framework: each a master process and the tasks it hands out."""
