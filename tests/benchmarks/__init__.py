"""Measurements by hand, and what tests take from them."""
