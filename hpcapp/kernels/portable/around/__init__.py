"""What lies around points: their neighbours, the planes through these, patches and their links."""
