"""Lower bounds that hold over all values of the unknowns, and what they prove of an estimate; one small file each."""
