"""Where values lie between the parts of a job: a folder that its machines share, or a bucket."""
