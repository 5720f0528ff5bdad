"""Pages of the site that are made from modules: problems, reference, published comparisons, gallery."""
