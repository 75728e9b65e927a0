"""Alignment (registration) of scans that lie in frames of their own.

`search` proposes poses, `judge` weighs every pose in one unit, `refinement` climbs to the best pose
nearby, `pair` tells how sure the best of all is, and `graph` spreads what is left over the loops.
"""
