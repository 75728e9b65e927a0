"""Amazon EC2, Eucalyptus, and every other cloud that speaks EC2."""
