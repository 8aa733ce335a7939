"""The tables of the paper recomputed on this plant, beside the published numbers."""
