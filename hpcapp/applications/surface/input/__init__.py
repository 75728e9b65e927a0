"""From a file to a clean cloud, in memory or in a folder."""
