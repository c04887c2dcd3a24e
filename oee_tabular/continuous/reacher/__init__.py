"""Reacher with longer or shorter links (the paper's Section VI.C)."""
