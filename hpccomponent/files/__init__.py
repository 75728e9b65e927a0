"""Files and folders: held by locks, private, shared between processes, named by users."""
