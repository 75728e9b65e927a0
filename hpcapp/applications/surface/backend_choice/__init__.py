"""Which backend a job runs on where the user named none."""
