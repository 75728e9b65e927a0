"""How the spacing of a cloud's points changes from place to place."""
