"""One declared problem under every method and formulation that accepts it, and why the others refuse."""
