"""One machine: how it is reached, asked, and set up."""
