"""Compiled loops on plain arrays. Nothing is validated here: the callers have. No fastmath."""
