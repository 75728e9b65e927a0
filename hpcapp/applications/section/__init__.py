"""Outlines where planes cut a surface, as drawings."""
