"""Reacher with longer or shorter links (the paper's Section VI.C): its dynamics, its expert, a linear model of it."""
