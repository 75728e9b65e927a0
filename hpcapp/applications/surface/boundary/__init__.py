"""Where a surface ends: what points support, open or closed, trim and holes."""
