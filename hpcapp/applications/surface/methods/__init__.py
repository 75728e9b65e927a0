"""What a method of reconstruction is, and the table of them."""
