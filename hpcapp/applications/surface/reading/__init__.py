"""From a file to a cloud: what can be used of it, and its ranges put into a folder."""
