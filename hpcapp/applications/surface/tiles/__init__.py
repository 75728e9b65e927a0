"""One tile of a job: its plan, its points and halo, and its finest level in slabs."""
