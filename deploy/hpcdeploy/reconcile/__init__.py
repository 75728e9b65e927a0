"""Making the cloud as the file says: observe, plan, carry out; and taking it away again."""
