"""Declared problems, one file each: the physics, what is unknown, and where it was published."""
