"""What tries the product out: simulated scans, the paper's figures, the smallest application."""
