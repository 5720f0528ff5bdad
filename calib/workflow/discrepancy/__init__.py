"""The discrepancy workflow: where model and readings disagree, which effect is missing, and how far the gap shrinks."""
